"""A Dask cluster in a process of its own, to be killed as a whole."""

import sys
import time
from pathlib import Path

import distributed

if __name__ == "__main__":
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=":0", silence_logs=50
    ) as cluster:
        Path(sys.argv[1]).write_text(cluster.scheduler_address)
        time.sleep(600.0)
