#!/bin/bash
# A scene on a PBS cluster, in LAMMPS, on as many ranks as there are MPI processes:
#
#     qsub -v scene=scene.toml,folder=run/ pbs.sh
#
# Submit the same line again to continue. Further variables: options="--tolerance 1e-7" for `lmpchain run`, and max_wall, which must
# leave some minutes to the walltime. Options of qsub before pbs.sh override:
#PBS -N lmpchain
#PBS -l select=1:ncpus=16:mpiprocs=16
#PBS -l walltime=24:00:00

# Make lmpchain available here, for example: module load mpich; source ~/venv/bin/activate

set -eu
cd "${PBS_O_WORKDIR:?must be set, as PBS does: submit with qsub}"
folder=${folder%/}/
wall=${max_wall:-23:55:00}

if [ -d "$folder" ]; then
    mpiexec lmpchain resume "$folder" --max-wall "$wall"
else
    # The options are several words.
    # shellcheck disable=SC2086
    mpiexec lmpchain run "$scene" -o "$folder" --engine lammps --max-wall "$wall" ${options:-}
fi
