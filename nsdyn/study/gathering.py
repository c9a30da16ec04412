"""Many calls of one function: here, in other processes, or by an executor. A task whose worker dies is tried again."""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from typing import Any

MESSAGES = 128
"""Largest number of messages with tasks to an executor. A message to a dask scheduler and back costs 10 ms of processor
time, so that many short tasks share one. A message still has so few of all tasks that its loss or delay does not
matter."""

AGAIN = 1.0
"""Time in s after which a running task is interrupted again: Python drops exceptions raised in finalisers and
callbacks."""

Tasks = Mapping[int, tuple[Any, ...]]
Outcome = tuple[int, Any, str]
Submit = Callable[..., Future[Any]]


def gather(function: Callable[..., Any], tasks: Tasks, workers: int | Executor | None) -> Iterator[Outcome]:
    """Call a function for every task and yield each outcome as it comes; in this process, its exceptions are raised.

    Parameters
    ----------
    function : callable
    tasks : mapping of int to tuple
        Arguments of the function, by number of the task.
    workers : int or Executor or None
        Number of processes to start, an executor, or None for this process.

    Yields
    ------
    (int, Any, str)
        Number of the task, return value of the function, and reason if there is no return value: its worker died twice.
    """
    if workers is None:
        for k, task in tasks.items():
            yield k, function(*task), ""
    elif isinstance(workers, int):
        count = min(workers, len(tasks))
        with _processes(count) as submit:
            yield from _sent(function, tasks, submit, 1, count)
    else:
        size = max(1, math.ceil(len(tasks) / MESSAGES))
        yield from _sent(function, tasks, workers.submit, size, len(tasks))


def _sent(function: Callable[..., Any], tasks: Tasks, submit: Submit, size: int, most: int) -> Iterator[Outcome]:
    """Send tasks, `size` in a message and at most `most` messages at once; tasks of a lost message again one by one."""
    numbers, tried = list(tasks), set[int]()
    waiting = deque(numbers[first : first + size] for first in range(0, len(numbers), size))
    running: dict[Future[list[Any]], list[int]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < most:
                some = waiting.popleft()
                try:
                    running[submit(_each, function, [tasks[k] for k in some])] = some
                except RuntimeError as broken:  # the executor accepts no more tasks
                    if some[0] not in tried:
                        raise
                    yield some[0], None, _reason(broken)
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                some = running.pop(future)
                try:
                    outcomes = future.result()
                except Exception as failure:  # the worker was lost, or data could not be sent
                    for k in some:
                        if k in tried:
                            yield k, None, _reason(failure)
                        else:
                            tried.add(k)
                            waiting.append([k])
                else:
                    yield from ((k, outcome, "") for k, outcome in zip(some, outcomes, strict=True))
    finally:
        for future in running:
            future.cancel()


def _each(function: Callable[..., Any], tasks: list[tuple[Any, ...]]) -> list[Any]:
    return [function(*task) for task in tasks]


def _reason(failure: Exception) -> str:
    return f"its worker was lost twice: {type(failure).__name__}: {' '.join(str(failure).split())}"


@contextmanager
def _processes(count: int) -> Iterator[Submit]:
    """Yield a function that calls another one in a process that is idle; in the end, running calls are interrupted.

    Each process has a pool of its own, so that one that dies loses only its own task, and is replaced. A pool alone
    would wait for running calls.
    """
    context = get_context("spawn")
    stopped, stop = context.Pipe(duplex=False)

    def pool() -> ProcessPoolExecutor:
        return ProcessPoolExecutor(1, context, _heed, (stopped,))

    pools, last = [pool() for _ in range(count)], dict[int, Future[Any]]()

    def submit(function: Callable[..., Any], *given: Any) -> Future[Any]:
        k = next(k for k in range(count) if k not in last or last[k].done())
        if k in last and isinstance(last[k].exception(), BrokenExecutor):  # the process died
            pools[k].shutdown(wait=False)
            pools[k] = pool()
        last[k] = pools[k].submit(_heeding, function, *given)
        return last[k]

    try:
        yield submit
    finally:
        stop.close()
        for one in pools:
            one.shutdown(cancel_futures=True)
        stopped.close()


_over = threading.Event()
"""Set in a process of a pool when no more tasks are wanted."""


def _heed(stopped: Connection) -> None:
    """Begin a process of a pool: it ignores interrupts between tasks, where they would end it during its messages."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.unraisablehook = _tell
    threading.Thread(target=_wait_for_stop, args=(stopped,), daemon=True).start()


def _tell(dropped: Any) -> None:
    """Report an exception that Python drops, except for interrupts, which are repeated."""
    if not issubclass(dropped.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(dropped)


def _wait_for_stop(stopped: Connection) -> None:
    """Interrupt the running task when the other end of the pipe is closed, also because the other process was killed.

    In the latter case nothing else would end this process: it waits for tasks from a pipe of which it holds both ends.
    """
    stopped.poll(None)
    _over.set()
    parent = parent_process()
    while True:
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)  # no effect while it is ignored
        time.sleep(AGAIN)
        if not (parent and parent.is_alive()) and signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
            os._exit(1)


def _heeding(function: Callable[..., Any], *task: Any) -> Any:
    """Call a function that may be interrupted; after an interrupt it has time to end before the next one."""
    last = -math.inf

    def interrupt(*_: Any) -> None:
        nonlocal last
        if time.monotonic() - last > 0.9 * AGAIN:
            last = time.monotonic()
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, interrupt)
    try:
        if _over.is_set():
            raise KeyboardInterrupt
        return function(*task)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
