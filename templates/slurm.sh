#!/bin/bash
# A scene on a SLURM cluster, in LAMMPS, on as many ranks as there are tasks:
#
#     sbatch slurm.sh scene.toml run/
#
# Submit the same line again to continue. Several such jobs, one after another:
#
#     for job in 1 2 3; do sbatch --job-name=run --dependency=singleton slurm.sh scene.toml run/ --tolerance 1e-7; done
#
# Options after the folder go to `lmpchain run`; those before slurm.sh go to SLURM and override:
#SBATCH --job-name=lmpchain
#SBATCH --ntasks=16
#SBATCH --cpus-per-task=1
#SBATCH --time=24:00:00

# Make lmpchain available here, for example: module load mpich; source ~/venv/bin/activate

set -eu
scene=$1
folder=${2%/}/
shift 2
spare=300 # s, to save everything before the time limit of the job
left=$((${SLURM_JOB_END_TIME:?must be set, as SLURM does from 22.05 on} - $(date +%s) - spare))

# if the ranks do not see each other: srun --mpi=pmi2, or another one that srun --mpi=list shows
if [ -d "$folder" ]; then
    srun lmpchain resume "$folder" --max-wall "$left"
else
    srun lmpchain run "$scene" -o "$folder" --engine lammps --max-wall "$left" "$@"
fi
