"""A search is the same for whoever computes it, loses nothing, and goes on where it stopped."""

import os
import signal
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from handctl.controller.gains import Gains, MotionGains
from handctl.errors import ConfigError
from handctl.hand.description import load_hand
from handctl.tune.ensemble import ensemble
from handctl.tune.search import RANDOM_BATCHES, Found, Plan, Trial, _sampler, _study, search
from handctl.tune.space import SPACE, within
from handctl.tune.trial import Score, evaluate
from handctl.tune.workers import Cluster, Here, Processes, Workers

TRIALS = 3


@pytest.fixture(scope="session")
def plan() -> Plan:
    """Few trials on the nominal plant."""
    return Plan(load_hand("jamia").to_toml(), 500.0, Gains(), ensemble(1, 0), seed=5, trials=TRIALS)


def _nothing(found: Found) -> None:
    return


@pytest.fixture(scope="session")
def found(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Found:
    """Searched in this process."""
    return search(plan, tmp_path_factory.mktemp("study") / "one", Here(), _nothing)


def test_two_processes_find_what_one_finds(plan: Plan, found: Found, tmp_path: Path) -> None:
    crew = Processes(2)
    try:
        assert search(plan, tmp_path / "two", crew, _nothing) == found
    finally:
        crew.close()
    assert len(found.trials) == TRIALS
    assert not found.trials[0].score.failure


def test_the_sampler_knows_which_trials_keep_their_margins(plan: Plan, found: Found, tmp_path: Path) -> None:
    """Those that were drawn at random, too; and Optuna has nothing to warn of."""
    search(plan, tmp_path / "study", Remembered(found), _nothing)
    told = _study(plan, tmp_path / "study").trials
    assert [one.constraints for one in told] == [{"margins": one.score.shortfall} for one in found.trials]
    with warnings.catch_warnings():
        warnings.simplefilter("error", FutureWarning)
        _sampler(plan.seed, RANDOM_BATCHES)


class Remembered:
    """Knows the scores already."""

    def __init__(self, found: Found) -> None:
        self.found = found

    def scores(self, jobs: Sequence[dict[str, Any]]) -> Iterator[tuple[int, dict[str, Any]]]:
        for i in range(len(jobs)):
            yield i, asdict(self.found.trials[i].score)

    def close(self) -> None:
        return


class Tired:
    """Works on some jobs, then is interrupted as by Ctrl-C."""

    def __init__(self, jobs: int) -> None:
        self.left = jobs

    def scores(self, jobs: Sequence[dict[str, Any]]) -> Iterator[tuple[int, dict[str, Any]]]:
        for i, job in enumerate(jobs):
            if not self.left:
                raise KeyboardInterrupt
            self.left -= 1
            yield i, evaluate(job)

    def close(self) -> None:
        return


def test_an_interrupted_search_goes_on_to_the_same_end(plan: Plan, found: Found, tmp_path: Path) -> None:
    crew: Workers = Tired(2)
    seen: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        search(plan, tmp_path / "study", crew, lambda now: seen.append(len(now.trials)))
    assert seen == [1, 2]
    assert search(plan, tmp_path / "study", Here(), lambda now: seen.append(len(now.trials))) == found
    assert seen == [1, 2, 3]


@pytest.mark.nightly
def test_the_death_of_a_worker_loses_nothing(plan: Plan, found: Found) -> None:
    crew = Processes(1)
    try:
        os.kill(crew.pids[0], signal.SIGKILL)
        jobs = [plan.job(one.values, first=i == 0) for i, one in enumerate(found.trials)]
        scores = {}
        for i, result in crew.scores(jobs):
            scores[i] = Score(**result)
            if i == 1:
                os.kill(crew.pids[0], signal.SIGKILL)
    finally:
        crew.close()
    assert [scores[i] for i in range(TRIALS)] == [one.score for one in found.trials]


@pytest.mark.nightly
def test_a_dask_cluster_finds_what_one_process_finds(plan: Plan, found: Found, tmp_path: Path) -> None:
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None) as cluster:
        crew = Cluster(cluster.scheduler_address)
        try:
            assert search(plan, tmp_path / "dask", crew, _nothing) == found
        finally:
            crew.close()


def test_a_study_of_something_else_is_refused(plan: Plan, tmp_path: Path) -> None:
    other = Plan(plan.hand, plan.rate_hz, plan.gains, plan.plants, seed=6, trials=1)
    with pytest.raises(KeyboardInterrupt):
        search(plan, tmp_path / "study", Tired(0), _nothing)
    with pytest.raises(ConfigError, match="another search"):
        search(other, tmp_path / "study", Here(), _nothing)
    (tmp_path / "text").write_text("no journal\n")
    with pytest.raises(ConfigError, match="cannot be used"):
        search(plan, tmp_path / "text", Here(), _nothing)


def test_only_good_trials_are_chosen() -> None:
    def trial(number: int, *numbers: float, failure: str = "") -> Trial:
        return Trial(number, {}, Score(*numbers, failure=failure))

    first = trial(0, 2.0, 4.0, 100.0, 60.0, 0.5)
    best, front = trial(1, 1.0, 2.0, 10.0, 60.0, -0.1), trial(2, 0.5, 5.0, 10.0, 60.0, -0.1)
    short, failed = trial(3, 0.1, 0.1, 0.1, 60.0, 0.1), trial(4, 0.1, 0.1, 0.1, 60.0, -1.0, failure="not taut")
    beaten = trial(5, 1.1, 2.1, 11.0, 60.0, -0.1)
    found = Found.of((first, best, front, short, failed, beaten))
    assert found.best == best
    assert found.front == (1, 2)
    assert found.cost(first) == pytest.approx(1.0)


def test_every_key_of_the_space_is_a_gain_and_the_packaged_ones_are_inside() -> None:
    assert all(one.low <= within(Gains())[key] <= one.high for key, one in SPACE.items())
    wild = Gains(motion=MotionGains(position_error_m=0.09))
    assert within(wild)["motion.position_error_m"] == SPACE["motion.position_error_m"].high
