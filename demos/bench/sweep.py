"""A sweep on a local dask cluster of two workers against one process, a worker killed on the way.

    python demos/bench/sweep.py [--runs 1000] [--time 1.0] [--rounds 2]

One process and the cluster take turns. A busy machine makes wall times useless, so the ratio is also that of processor
times: of one process, to half of what client, scheduler and workers took together, which is what two idle cores need.
In the last turn a worker is killed after a third of the time: nothing may be lost, and all bits are those of one
process. Needs the extra `cluster`.
"""

import argparse
import os
import signal
import threading
import time

import numpy as np
import psutil
from distributed import Client, LocalCluster

import nsdyn as nd
from nsdyn.study.sweep import figures


def processor_time(processes: list[int]) -> float:
    """User and system time of processes so far, s."""
    return sum(sum(psutil.Process(process).cpu_times()[:2]) for process in processes)


def sweep(runs: int, duration: float, executor: object) -> list[object]:
    """What came of `runs` short slides."""
    values = {"heading": np.linspace(0.0, 90.0, 10).tolist(), "mu": np.linspace(0.05, 1.0, max(1, runs // 10)).tolist()}
    return [member.result for member in nd.sweep("slide", values, duration, executor, figures, dt=1e-2)]


def main() -> None:
    """Take turns and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--time", type=float, default=1.0)
    parser.add_argument("--rounds", type=int, default=2)
    options = parser.parse_args()
    me = os.getpid()
    sweep(10, options.time, None)
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
        client.get_executor() as executor,
    ):
        workers = list(client.run(os.getpid).values())
        sweep(20, options.time, executor)
        for _ in range(options.rounds):
            spent, start = processor_time([me]), time.perf_counter()
            alone = sweep(options.runs, options.time, None)
            spent, wall = processor_time([me]) - spent, time.perf_counter() - start
            before, start = processor_time([me, *workers]), time.perf_counter()
            together = sweep(options.runs, options.time, executor)
            cluster_spent, cluster_wall = processor_time([me, *workers]) - before, time.perf_counter() - start
            print(
                f"one process {wall:.1f} s ({spent:.1f} s of processor), two workers {cluster_wall:.1f} s "
                f"({cluster_spent:.1f} s): {wall / cluster_wall:.2f} times as fast, "
                f"by processor time {2.0 * spent / cluster_spent:.2f}; same bits: {alone == together}",
                flush=True,
            )
        threading.Timer(cluster_wall / 3.0, lambda: os.kill(workers[0], signal.SIGKILL)).start()
        start = time.perf_counter()
        survived = sweep(options.runs, options.time, executor)
        missing = sum(result is None for result in survived)
        print(
            f"a worker killed after {cluster_wall / 3.0:.1f} of {time.perf_counter() - start:.1f} s: "
            f"{missing} of {len(survived)} lost, same bits: {survived == alone}"
        )


if __name__ == "__main__":
    main()
