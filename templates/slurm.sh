#!/bin/bash
# A scene on a SLURM cluster, in LAMMPS, on as many ranks as there are tasks:
#
#     sbatch slurm.sh scene.toml run/
#
# The same line again goes on where the job before ended. Several such jobs, one after another:
#
#     for job in 1 2 3; do sbatch --job-name=run --dependency=singleton slurm.sh scene.toml run/ --tolerance 1e-7; done
#
# What stands behind the folder goes to `lmpchain run`; what stands before slurm.sh goes to SLURM, and counts more than:
#SBATCH --job-name=lmpchain
#SBATCH --ntasks=16
#SBATCH --cpus-per-task=1
#SBATCH --time=24:00:00

# Put here what lets your shell find lmpchain, such as: module load mpich; source ~/venv/bin/activate

set -eu
scene=$1
folder=${2%/}/
shift 2
spare=300 # s, to save everything before the time of the job is over
left=$((${SLURM_JOB_END_TIME:?must be set, as SLURM does from 22.05 on} - $(date +%s) - spare))

# if the ranks do not see each other: srun --mpi=pmi2, or another one that srun --mpi=list shows
if [ -d "$folder" ]; then
    srun lmpchain resume "$folder" --max-wall "$left"
else
    srun lmpchain run "$scene" -o "$folder" --engine lammps --max-wall "$left" "$@"
fi
