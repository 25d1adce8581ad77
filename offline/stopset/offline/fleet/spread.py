"""The arms of a fleet spread over workers: here one after the other, or on a Dask cluster; a worker that dies costs no answer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from stopset.offline.campaign.map_reduce import connected
from stopset.offline.fleet.arms import ArmAnswer, ArmFolder, examined


def answers(arms: Sequence[ArmFolder], scheduler: str | None = None, workers: int = 0) -> Iterator[ArmAnswer]:
    """Each arm's answer as it is found; the same whoever finds it.

    ``scheduler``: address of a Dask cluster whose workers read the same files; else at most ``workers`` processes of this machine, 0: this
    process. Raises `StopsetError` where there is no such cluster.
    """
    if scheduler is not None:
        with connected(scheduler) as client:
            yield from _spread(client, arms)
    elif workers:
        from distributed import Client, LocalCluster

        local = LocalCluster(
            n_workers=min(workers, len(arms)), threads_per_worker=1, processes=True, host="127.0.0.1",
            dashboard_address=None, silence_logs=50,
        )  # fmt: skip
        with local, Client(local, set_as_default=False) as client:
            yield from _spread(client, arms)
    else:
        yield from map(examined, arms)


def _spread(client: Any, arms: Sequence[ArmFolder]) -> Iterator[ArmAnswer]:
    from distributed import KilledWorker, as_completed

    jobs = dict(zip(client.map(examined, arms, pure=False), arms, strict=True))
    for job in as_completed(list(jobs), loop=client.loop):
        try:
            yield job.result()
        except KilledWorker:
            why = "every worker that took it died; expected one with memory enough: give the workers more"
            yield ArmAnswer(jobs[job].name, error=why)
