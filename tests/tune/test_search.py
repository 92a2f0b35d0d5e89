"""Test the search for gains.

The result of a search does not depend on the kind of its worker processes. No trial of the search
is lost, and an interrupted search can be resumed.
"""

import os
import signal
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from handctl.core.gains.gains import Gains, MotionGains, packaged_gains
from handctl.errors import ConfigError
from handctl.hand.hand_loading import load_hand
from handctl.tune.scoring import GainScore, evaluate_job
from handctl.tune.search.ensemble import sample_ensemble
from handctl.tune.search.gain_search import (
    RANDOM_BATCH_COUNT,
    SearchPlan,
    SearchResult,
    SearchTrial,
    _make_sampler,
    _open_study,
    run_search,
    without_uncommissionable_trials,
)
from handctl.tune.search.search_space import GAIN_RANGES, clamped_gains
from handctl.tune.search.workers import DaskCluster, InProcessWorkers, ProcessPool, SearchWorkers

TRIAL_COUNT = 3


@pytest.fixture(scope="session")
def search_plan() -> SearchPlan:
    """Return the plan of a search with few trials.

    All trials use the simulated hand with its nominal parameters.
    """
    return SearchPlan(
        load_hand("jamia").to_toml(),
        500.0,
        Gains(),
        sample_ensemble(1, 0),
        seed=5,
        trials=TRIAL_COUNT,
    )


def _ignore_result(search_result: SearchResult) -> None:
    return


@pytest.fixture(scope="session")
def search_result(
    search_plan: SearchPlan, tmp_path_factory: pytest.TempPathFactory
) -> SearchResult:
    """Run a search in the test process, and return the result of the search."""
    return run_search(
        search_plan, tmp_path_factory.mktemp("study") / "one", InProcessWorkers(), _ignore_result
    )


def test_search_result_does_not_depend_on_the_processes(
    search_plan: SearchPlan, search_result: SearchResult, tmp_path: Path
) -> None:
    workers = ProcessPool(2)
    try:
        assert run_search(search_plan, tmp_path / "two", workers, _ignore_result) == search_result
    finally:
        workers.close()
    assert len(search_result.trials) == TRIAL_COUNT
    assert not search_result.trials[0].score.failure


def test_the_sampler_knows_which_trials_keep_their_margins(
    search_plan: SearchPlan, search_result: SearchResult, tmp_path: Path
) -> None:
    """Optuna's sampler uses the stability margins of each trial as constraints, even if the trial has random gains.

    Optuna prints no warnings.
    """
    run_search(search_plan, tmp_path / "study", RecordedWorkers(search_result), _ignore_result)
    finished_trials = [
        trial
        for trial in _open_study(search_plan, tmp_path / "study").trials
        if trial.state.is_finished()
    ]
    assert [trial.constraints for trial in finished_trials] == [
        {"margins": trial.score.shortfall} for trial in search_result.trials
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("error", FutureWarning)
        _make_sampler(search_plan.seed, RANDOM_BATCH_COUNT)


class RecordedWorkers:
    """Workers that compute no scores, but return the scores of an earlier search."""

    def __init__(self, search_result: SearchResult) -> None:
        self.found = search_result

    def compute_scores(
        self, jobs: Sequence[dict[str, Any]]
    ) -> Iterator[tuple[int, dict[str, Any]]]:
        for i in range(len(jobs)):
            yield i, asdict(self.found.trials[i].score)

    def close(self) -> None:
        return


class InterruptedWorkers:
    """Workers that raise KeyboardInterrupt after some jobs, as if the user had pressed Ctrl-C."""

    def __init__(self, completed_jobs: int) -> None:
        self.left = completed_jobs

    def compute_scores(
        self, jobs: Sequence[dict[str, Any]]
    ) -> Iterator[tuple[int, dict[str, Any]]]:
        for i, job in enumerate(jobs):
            if not self.left:
                raise KeyboardInterrupt
            self.left -= 1
            yield i, evaluate_job(job)

    def close(self) -> None:
        return


@pytest.mark.nightly
def test_interrupted_search_gives_the_same_result(
    search_plan: SearchPlan, search_result: SearchResult, tmp_path: Path
) -> None:
    workers: SearchWorkers = InterruptedWorkers(2)
    trial_counts: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        run_search(
            search_plan,
            tmp_path / "study",
            workers,
            lambda now: trial_counts.append(len(now.trials)),
        )
    assert trial_counts == [1, 2]
    assert (
        run_search(
            search_plan,
            tmp_path / "study",
            InProcessWorkers(),
            lambda now: trial_counts.append(len(now.trials)),
        )
        == search_result
    )
    assert trial_counts == [1, 2, 3]


class FakeWorkers:
    """Workers that compute the score of a trial from its gains by a formula, instead of by a simulation."""

    def compute_scores(
        self, jobs: Sequence[dict[str, Any]]
    ) -> Iterator[tuple[int, dict[str, Any]]]:
        for i, job in enumerate(jobs):
            motion, tension = job["gains"]["motion"], job["gains"]["tension"]
            score_parts = (
                motion["position_error_m"],
                tension["tension_error_N"],
                motion["speed_error_m_s"],
            )
            yield i, asdict(GainScore(*score_parts, 50.0, motion["disturbance_rejection"] - 0.8))

    def close(self) -> None:
        return


@pytest.fixture(scope="module")
def long_search(
    search_plan: SearchPlan, tmp_path_factory: pytest.TempPathFactory
) -> tuple[SearchPlan, SearchResult, bytes]:
    """Run a search that begins with random trials.

    After the random trials, the sampler chooses the trials of each batch. Return the plan of the
    search, its result, and the bytes of its journal.
    """
    longer_plan = replace(
        search_plan,
        trials=8 * RANDOM_BATCH_COUNT + 2,
        further_gains=(Gains(motion=MotionGains(force_N=20.0)),),
    )
    path = tmp_path_factory.mktemp("study") / "whole"
    return (
        longer_plan,
        run_search(longer_plan, path, FakeWorkers(), _ignore_result),
        path.read_bytes(),
    )


@pytest.mark.parametrize("journal_fraction", [0.01, 0.03, 0.1, 0.25, 0.45, 0.6, 0.9, 0.99])
def test_search_resumes_from_a_truncated_journal(
    long_search: tuple[SearchPlan, SearchResult, bytes], tmp_path: Path, journal_fraction: float
) -> None:
    """In this test, the journal of a search is cut off in the middle of a line.

    A search begins with random trials, and the sampler chooses the later trials. With a small
    ``journal_fraction``, the journal is cut off within the random trials. With a large
    ``journal_fraction``, the journal is cut off within the trials of the sampler.
    """
    longer_plan, complete_result, journal = long_search
    path, lines = tmp_path / "study", journal.splitlines(keepends=True)
    line_count = int(journal_fraction * len(lines))
    path.write_bytes(b"".join(lines[:line_count]) + lines[line_count][:40])
    assert run_search(longer_plan, path, FakeWorkers(), _ignore_result) == complete_result
    assert run_search(longer_plan, path, FakeWorkers(), _ignore_result) == complete_result


def test_an_extended_search_equals_one_long_search(
    long_search: tuple[SearchPlan, SearchResult, bytes], tmp_path: Path
) -> None:
    longer_plan, complete_result, _ = long_search
    assert (
        len(
            run_search(
                replace(longer_plan, trials=10), tmp_path / "study", FakeWorkers(), _ignore_result
            ).trials
        )
        == 10
    )
    assert (
        run_search(longer_plan, tmp_path / "study", FakeWorkers(), _ignore_result)
        == complete_result
    )


@pytest.mark.parametrize(
    ("original_bytes", "damaged_bytes"),
    [
        (b'{"op_code":6', b'{"op_code":99'),
        (b'{"op_code":4', b'[1]\n{"op_code":4'),
        (b'"score"', b'"scare"'),
        (b'"tracking_deg"', b'"tracking"'),
        (b'{"op_code":0', b'{ "op_code":0'),
    ],
)
def test_a_damaged_journal_is_refused_and_keeps_what_it_holds(
    long_search: tuple[SearchPlan, SearchResult, bytes],
    tmp_path: Path,
    original_bytes: bytes,
    damaged_bytes: bytes,
) -> None:
    longer_plan, _, journal = long_search
    damaged_journal = journal.replace(original_bytes, damaged_bytes)
    assert damaged_journal != journal
    (tmp_path / "study").write_bytes(damaged_journal)
    with pytest.raises(ConfigError, match="cannot be used"):
        run_search(longer_plan, tmp_path / "study", FakeWorkers(), _ignore_result)
    assert (tmp_path / "study").read_bytes().startswith(damaged_journal)


@pytest.mark.nightly
def test_a_killed_worker_loses_no_result(
    search_plan: SearchPlan, search_result: SearchResult
) -> None:
    workers = ProcessPool(1)
    try:
        os.kill(workers.process_ids[0], signal.SIGKILL)
        jobs = [
            search_plan.trial_job(i, trial.values) for i, trial in enumerate(search_result.trials)
        ]
        scores = {}
        for i, result in workers.compute_scores(jobs):
            scores[i] = GainScore(**result)
            if i == 1:
                os.kill(workers.process_ids[0], signal.SIGKILL)
    finally:
        workers.close()
    assert [scores[i] for i in range(TRIAL_COUNT)] == [
        trial.score for trial in search_result.trials
    ]


@pytest.mark.nightly
def test_a_dask_cluster_finds_what_one_process_finds(
    search_plan: SearchPlan, search_result: SearchResult, tmp_path: Path
) -> None:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
    ) as cluster:
        workers = DaskCluster(cluster.scheduler_address)
        try:
            assert (
                run_search(search_plan, tmp_path / "dask", workers, _ignore_result) == search_result
            )
        finally:
            workers.close()


def test_two_searches_do_not_share_a_journal(search_plan: SearchPlan, tmp_path: Path) -> None:
    class WorkersWithSecondSearch(InProcessWorkers):
        """Workers that, during a search, try to start a second search with the same journal."""

        def compute_scores(
            self, jobs: Sequence[dict[str, Any]]
        ) -> Iterator[tuple[int, dict[str, Any]]]:
            with pytest.raises(ConfigError, match="another search uses it"):
                run_search(search_plan, tmp_path / "one", InProcessWorkers(), _ignore_result)
            yield from super().compute_scores(jobs)

    assert (
        len(
            run_search(
                replace(search_plan, trials=1),
                tmp_path / "one",
                WorkersWithSecondSearch(),
                _ignore_result,
            ).trials
        )
        == 1
    )


def test_journal_of_another_study_is_refused(search_plan: SearchPlan, tmp_path: Path) -> None:
    other_plan = SearchPlan(
        search_plan.hand,
        search_plan.rate_hz,
        search_plan.gains,
        search_plan.plants,
        seed=6,
        trials=1,
    )
    with pytest.raises(KeyboardInterrupt):
        run_search(search_plan, tmp_path / "study", InterruptedWorkers(0), _ignore_result)
    with pytest.raises(ConfigError, match="another search"):
        run_search(other_plan, tmp_path / "study", InProcessWorkers(), _ignore_result)
    (tmp_path / "text").write_text("no journal\n")
    with pytest.raises(ConfigError, match="cannot be used"):
        run_search(search_plan, tmp_path / "text", InProcessWorkers(), _ignore_result)


def test_only_good_trials_are_chosen() -> None:
    def trial(trial_number: int, *score_values: float, failure: str = "") -> SearchTrial:
        return SearchTrial(trial_number, {}, GainScore(*score_values, failure=failure))

    first_trial = trial(0, 2.0, 4.0, 100.0, 60.0, 0.5)
    best, front_trial = trial(1, 1.0, 2.0, 10.0, 60.0, -0.1), trial(2, 0.5, 5.0, 10.0, 60.0, -0.1)
    short_trial, failed_trial = (
        trial(3, 0.1, 0.1, 0.1, 60.0, 0.1),
        trial(4, 0.1, 0.1, 0.1, 60.0, -1.0, failure="not taut"),
    )
    dominated_trial = trial(5, 1.1, 2.1, 11.0, 60.0, -0.1)
    chosen_result = SearchResult.from_trials(
        (first_trial, best, front_trial, short_trial, failed_trial, dominated_trial)
    )
    assert chosen_result.best == best
    assert chosen_result.pareto_front == (1, 2)
    assert chosen_result.relative_cost(first_trial) == pytest.approx(1.0)


def test_gains_that_cannot_commission_the_hand_are_not_chosen() -> None:
    """Test that the gains of the best trial of a search can commission the hand.

    A search for the hand orca_like chose gains with which the commissioning failed. With these
    gains, a commanded tension of 3 N caused a motor force of only 1.7 N.
    """
    plan = SearchPlan(
        load_hand("orca_like").to_toml(),
        400.0,
        packaged_gains("orca_like"),
        ({"stiffness": 0.85, "friction": 1.2},),
        seed=5,
        trials=3,
    )
    weak_values = {
        "motion.tension_feedback": 0.57,
        "tension.tension_error_N": 44.0,
        "tension.integral_per_s": 0.43,
        "filter.motor_disturbance_N": 0.033,
        "filter.free_rate_N_per_s": 192.0,
    }
    trials = (
        SearchTrial(0, {}, GainScore(2.0, 4.0, 100.0, 60.0, 0.5)),
        SearchTrial(1, weak_values, GainScore(1.0, 2.0, 10.0, 60.0, -0.1)),
        SearchTrial(2, {}, GainScore(1.5, 3.0, 10.0, 60.0, -0.1)),
    )
    shown_trials: list[SearchTrial] = []
    result = without_uncommissionable_trials(
        plan, SearchResult.from_trials(trials), shown_trials.append
    )
    assert result.best == trials[2]
    assert shown_trials == [trials[1], trials[2]]
    assert "answers" in result.trials[1].score.failure


def test_costs_are_those_of_the_first_good_trial_if_the_first_failed() -> None:
    lost_trial = SearchTrial(0, {}, GainScore(1e3, 1e3, 1e3, 60.0, 0.0, "not taut"))
    feasible_trials = [
        SearchTrial(1, {}, GainScore(1.0, 2.0, 3.0, 60.0, -0.1)),
        SearchTrial(2, {}, GainScore(0.5, 1.0, 1.5, 60.0, -0.1)),
    ]
    chosen_result = SearchResult.from_trials((lost_trial, *feasible_trials))
    assert [chosen_result.relative_cost(trial) for trial in feasible_trials] == pytest.approx(
        [1.0, 0.5]
    )
    assert chosen_result.best == feasible_trials[1]


def test_first_trial_keeps_gains_outside_the_search_space(search_plan: SearchPlan) -> None:
    plan_outside_search_space = replace(
        search_plan, gains=Gains(motion=MotionGains(speed_error_m_s=0.01))
    )
    assert (
        plan_outside_search_space.gains_of(0, clamped_gains(plan_outside_search_space.gains))
        == plan_outside_search_space.gains
    )
    assert plan_outside_search_space.trial_job(0, clamped_gains(plan_outside_search_space.gains))[
        "gains"
    ] == plan_outside_search_space.gains.model_dump(by_alias=True)
    assert (
        plan_outside_search_space.gains_of(
            1, clamped_gains(plan_outside_search_space.gains)
        ).motion.speed_error_m_s
        == GAIN_RANGES["motion.speed_error_m_s"].low
    )


def test_every_key_of_the_space_is_a_gain_and_the_packaged_ones_are_inside() -> None:
    assert all(
        gain_range.low <= clamped_gains(Gains())[key] <= gain_range.high
        for key, gain_range in GAIN_RANGES.items()
    )
    gains_outside_search_space = Gains(motion=MotionGains(position_error_m=0.09))
    assert (
        clamped_gains(gains_outside_search_space)["motion.position_error_m"]
        == GAIN_RANGES["motion.position_error_m"].high
    )
