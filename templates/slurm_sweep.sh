#!/bin/bash
# Solve a sweep on one node of a SLURM cluster, on all cores of the job:
#
#     sbatch --cpus-per-task=32 slurm_sweep.sh sweep.toml results
#
# Submit the line again after a time limit: the sweep computes only the scenes that are missing.
# Options before slurm_sweep.sh go to SLURM and override:
#SBATCH --job-name=lmpchain
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=16
#SBATCH --time=24:00:00

# Make lmpchain available here, for example: source ~/venv/bin/activate

set -eu
srun lmpchain sweep "$1" -o "$2" --workers "${SLURM_CPUS_PER_TASK:-1}"
