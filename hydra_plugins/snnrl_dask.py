"""hydra/launcher=dask: the jobs of a sweep on the workers of a Dask cluster, on this machine or on many.

A job whose worker dies is done again by another one; `snnrl.running.job` then goes on from its last checkpoint.
"""

# no annotations from __future__: Hydra executes this file before it is among the modules, where dataclasses look for it
import logging
import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn, JobStatus, configure_log, run_job, setup_globals
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, open_dict

ONE_AT_A_TIME = Lock()  # Hydra keeps what it knows of a job in one place of a process


@dataclass
class DaskConfig:
    """What `hydra.launcher` may hold.

    Attributes:
        workers: processes of a cluster that is made for the sweep, on this machine; unless there is one already:
        address: of its scheduler, or
        scheduler_file: that its scheduler has written.
        cpus_per_task: threads of a job that was not told how many.
    """

    _target_: str = "hydra_plugins.snnrl_dask.DaskLauncher"
    workers: int = 2
    address: str | None = None
    scheduler_file: str | None = None
    cpus_per_task: int = 1


ConfigStore.instance().store(group="hydra/launcher", name="dask", node=DaskConfig, provider="snnrl")


class DaskLauncher(Launcher):
    """See `DaskConfig`."""

    def __init__(self, workers: int, address: str | None, scheduler_file: str | None, cpus_per_task: int) -> None:
        self.workers, self.address, self.scheduler_file = workers, address, scheduler_file

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        self.context, self.task, self.config = hydra_context, task_function, config

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """What has come of each job, once all have ended."""
        setup_globals()
        configure_log(self.config.hydra.hydra_logging, self.config.hydra.verbose)
        Path(str(self.config.hydra.sweep.dir)).mkdir(parents=True, exist_ok=True)
        job = partial(perform, self.context, self.task, self.config, Singleton.get_state(), os.getcwd())
        with ExitStack() as stack:
            client = self._client(stack)
            from distributed.protocol.pickle import dumps

            # sent once to each worker, not with each job; a task, so that it is made again if workers that have it die
            shared = client.submit(itself, dumps(job), pure=False)
            numbers = range(initial_job_idx, initial_job_idx + len(job_overrides))
            jobs = [
                client.submit(call, shared, number, list(overrides), pure=False)
                for number, overrides in zip(numbers, job_overrides, strict=True)
            ]
            return [self._ended(future, overrides) for future, overrides in zip(jobs, job_overrides, strict=True)]

    def _client(self, stack: ExitStack) -> Any:
        """Of the cluster that there is, or of one that lasts as long as the stack."""
        from snnrl.errors import ConfigError

        try:
            from distributed import Client, LocalCluster
        except ImportError:
            raise ConfigError("hydra/launcher", "dask", 'needs distributed: pip install "snnrl[cluster]"') from None
        logging.getLogger("distributed").setLevel(logging.WARNING)
        if self.scheduler_file is not None:
            return stack.enter_context(Client(scheduler_file=self.scheduler_file))
        if self.address is not None:
            return stack.enter_context(Client(self.address))
        # what a worker has to say when its cluster ends between two words of theirs: nobody's error; a job's comes back
        quiet = {"dashboard_address": None, "silence_logs": logging.CRITICAL}
        cluster = LocalCluster(n_workers=self.workers, threads_per_worker=1, **quiet)
        return stack.enter_context(Client(stack.enter_context(cluster)))

    def _ended(self, future: Any, overrides: Sequence[str]) -> JobReturn:
        """What has come of a job; also of one whose workers have died again and again."""
        error = future.exception()
        if error is None:
            ended: JobReturn = future.result()
            return ended
        return JobReturn(overrides=list(overrides), status=JobStatus.FAILED, _return_value=error)


def itself(job: bytes) -> bytes:
    """What all jobs have in common, as a result that workers keep."""
    return job


def call(job: bytes, number: int, overrides: list[str]) -> JobReturn:
    """One of the jobs; what they have in common is read anew for each, as a job changes it."""
    from distributed.protocol.pickle import loads

    ended: JobReturn = loads(job)(number, overrides)
    return ended


def perform(
    context: HydraContext,
    task: TaskFunction,
    config: DictConfig,
    state: dict[Any, Any],
    folder: str,
    number: int,
    overrides: list[str],
) -> JobReturn:
    """One job, in a worker, whose working folder becomes that of the sweep."""
    with ONE_AT_A_TIME:
        os.chdir(folder)
        setup_globals()
        Singleton.set_state(state)
        sweep = context.config_loader.load_sweep_config(config, overrides)
        with open_dict(sweep):
            sweep.hydra.job.id = f"{sweep.hydra.job.name}_{number}"
            sweep.hydra.job.num = number
        HydraConfig.instance().set_config(sweep)
        ended = run_job(task, sweep, "hydra.sweep.dir", "hydra.sweep.subdir", context)
        ended.cfg = ended.hydra_cfg = None  # which the worker would keep of each job until the last one is done
        return ended
