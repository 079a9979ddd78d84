"""Solve a sweep on the workers that Dask starts in a batch queue.

    pip install "lmpchain[cluster]" dask-jobqueue
    python dask_sweep.py sweep.toml results

Run it on a node that all others reach, such as the login node, in a folder that all of them share.
Run the same line again to compute the scenes that are missing.
"""

import sys

from dask_jobqueue import SLURMCluster  # or PBSCluster, LSFCluster, SGECluster

import lmpchain

if __name__ == "__main__":
    sweep, folder = sys.argv[1:]
    # Each job has 16 workers of one thread, because a scene is solved by one process.
    with SLURMCluster(cores=16, processes=16, memory="32GB", walltime="04:00:00") as cluster:
        cluster.scale(jobs=10)
        results = lmpchain.sweep(sweep, folder, scheduler=cluster.scheduler_address)
    failed = int((results.reason != "").sum())
    print(f"{results.reason.size - failed} of {results.reason.size} scenes are solved")
    sys.exit(int(failed > 0))
