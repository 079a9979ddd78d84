#!/bin/bash
# Solve one scene file in each task of a SLURM job array:
#
#     sbatch --array=1-100 slurm_array.sh "scenes/*.toml" runs/
#
# Task n solves the n-th file of the pattern and saves runs/NAME.nc. Submit the line again to solve the scenes that have no file yet.
# Options after the folder go to `lmpchain run`; options before slurm_array.sh go to SLURM and override:
#SBATCH --job-name=lmpchain
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=1
#SBATCH --time=1:00:00

# Make lmpchain available here, for example: source ~/venv/bin/activate

set -eu
mapfile -t scenes < <(compgen -G "$1")
folder=${2%/}
shift 2
scene=${scenes[${SLURM_ARRAY_TASK_ID:?must be set: submit with sbatch --array=1-N} - 1]}
name=$(basename "$scene" .toml)
mkdir -p "$folder"
[ -e "$folder/$name.nc" ] || lmpchain run "$scene" -o "$folder/$name.nc" "$@"
