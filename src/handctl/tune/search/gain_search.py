"""Search for gains in simulation, with the package Optuna. The result depends only on the seed.

The search requests trials from Optuna in batches of a fixed size. The search reports the scores in
the order of the trials. Each batch has a separate sampler, whose seed follows from the seed of the
study and the number of the batch. Because the size and the seed of each batch are fixed, the result
does not depend on the number of processes. For the same reason, an interrupted study can be
resumed. A resumed study begins with the trials of the last batch that have no score yet. If a batch
was only partly requested, the whole batch is requested again.
"""

import fcntl
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from handctl.core.gains.gain_bounds import gains_with_values
from handctl.core.gains.gains import Gains
from handctl.errors import ConfigError
from handctl.tune.scoring import GainScore, commissioning_failure
from handctl.tune.search.search_space import GAIN_RANGES, clamped_gains
from handctl.tune.search.workers import SearchWorkers

BATCH_SIZE = 8
"""Number of trials in a batch. Worker processes beyond this number stay idle."""
RANDOM_BATCH_COUNT = 2
"""Number of batches with random trials. Later batches use the results of earlier trials."""
STUDY_NAME = "handctl"
"""Name of the study in the journal."""


@dataclass(frozen=True)
class SearchPlan:
    """Settings of a search for gains.

    Attributes:
        hand: text of the hand file, because a worker on another machine can lack the file.
        rate_hz: control rate [Hz].
        gains: gains of the first trial. All gains that the search does not vary keep the values of
            the first trial.
        plants: factors of the plants of the ensemble.
        seed: seed of the samplers and of the simulated noise.
        trials: number of trials.
        further_gains: further gains that are tried before the random trials, for example those of a
            design.
    """

    hand: str
    rate_hz: float
    gains: Gains
    plants: tuple[dict[str, float], ...]
    seed: int
    trials: int
    further_gains: tuple[Gains, ...] = ()

    def gains_of(self, trial_number: int, gain_values: Mapping[str, float]) -> Gains:
        """Return the gains of a trial.

        The first trial has exactly the gains from the search plan, even if these gains are outside
        of the search space.
        """
        return gains_with_values(self.gains, gain_values, "study") if trial_number else self.gains

    def trial_job(self, trial_number: int, gain_values: Mapping[str, float]) -> dict[str, Any]:
        """Return the job of a trial: the data from which a worker computes the score of the trial.

        The costs of all trials are relative to the first trial. Therefore the worker simulates the
        first trial even if the margins of its gains are too small.
        """
        return {
            "hand": self.hand,
            "rate_hz": self.rate_hz,
            "gains": self.gains_of(trial_number, gain_values).model_dump(by_alias=True),
            "plants": list(self.plants),
            "seed": self.seed,
            "must_keep_margins": trial_number > 0,
        }

    @property
    def identity(self) -> str:
        """Return the settings of the plan that must stay the same if an interrupted study is resumed."""
        plain_fields = {
            "hand": self.hand,
            "rate_hz": self.rate_hz,
            "plants": self.plants,
            "seed": self.seed,
        }
        return json.dumps(
            plain_fields | {"gains": self.gains.model_dump(by_alias=True)}, sort_keys=True
        )


@dataclass(frozen=True, slots=True)
class SearchTrial:
    """Finished trial of a search."""

    number: int
    values: dict[str, float]
    score: GainScore

    @property
    def is_feasible(self) -> bool:
        """Return True if the run of the trial finished the exercise, and the margins of the gains are large enough."""
        return not self.score.failure and self.score.shortfall <= 0.0


@dataclass(frozen=True, slots=True)
class SearchResult:
    """Result of a search.

    Attributes:
        trials: finished trials in order. The first trial has the gains of the plan.
        best: feasible trial with the smallest cost, or None if no trial is feasible.
        pareto_front: numbers of the Pareto-optimal feasible trials.
    """

    trials: tuple[SearchTrial, ...]
    best: SearchTrial | None
    pareto_front: tuple[int, ...]

    @staticmethod
    def from_trials(trials: tuple[SearchTrial, ...]) -> "SearchResult":
        """Return the result of a search, given the trials that are finished."""
        feasible_trials = [trial for trial in trials if trial.is_feasible]
        best = (
            min(
                feasible_trials,
                key=lambda trial: (
                    trial.score.relative_cost(_cost_reference(trials)),
                    trial.number,
                ),
            )
            if feasible_trials
            else None
        )
        pareto_numbers = [
            trial.number
            for trial in feasible_trials
            if not any(
                _dominates(other_trial.score, trial.score) for other_trial in feasible_trials
            )
        ]
        return SearchResult(trials, best, tuple(pareto_numbers))

    def relative_cost(self, trial: SearchTrial) -> float:
        """Return the cost of a trial relative to the cost of the first trial.

        If the first trial failed, the first feasible trial is the reference.
        """
        return trial.score.relative_cost(_cost_reference(self.trials))


def _cost_reference(trials: tuple[SearchTrial, ...]) -> GainScore:
    """Return the score of the trial that serves as the reference for costs."""
    first_score = trials[0].score
    feasible_scores = (trial.score for trial in trials if trial.is_feasible)
    return next(feasible_scores, first_score) if first_score.failure else first_score


def _dominates(score: GainScore, other_score: GainScore) -> bool:
    """Return True if ``score`` dominates ``other_score``: better in one objective or more, and worse in none."""
    pairs = list(zip(score.objectives, other_score.objectives, strict=True))
    return all(a <= b for a, b in pairs) and any(a < b for a, b in pairs)


def run_search(
    plan: SearchPlan,
    storage_path: Path,
    workers: SearchWorkers,
    show_result: Callable[[SearchResult], None],
) -> SearchResult:
    """Run a search, or resume an interrupted search.

    Args:
        plan: plan of the search.
        storage_path: path of an Optuna journal, either a new file or a journal of the same plan.
        workers: workers that compute the trials.
        show_result: function that is called after each trial.

    Raises:
        ConfigError: the storage contains another search, or another process uses the storage.
    """
    with _exclusive_lock(storage_path):
        study = _open_study(plan, storage_path)
        while len(_finished_trials(study)) < plan.trials:
            _run_batch(study, plan, workers, show_result)
        return SearchResult.from_trials(_finished_trials(study))


def without_uncommissionable_trials(
    plan: SearchPlan, result: SearchResult, show_trial: Callable[[SearchTrial], None]
) -> SearchResult:
    """Mark trials as failed until the gains of the best trial can commission every plant, and return the result.

    The exercise begins with a commissioned hand, so that its score does not show whether the gains
    can commission the hand. The function commissions the plants with the gains of the best trial.
    If the commissioning of a plant fails, the trial counts as failed, and the function checks the
    next best trial.

    Args:
        plan: plan of the search.
        result: result of the search.
        show_trial: function that is called before the plants are commissioned with a trial's gains.
    """
    while result.best is not None:
        best = result.best
        show_trial(best)
        failure_text = commissioning_failure(plan.trial_job(best.number, best.values))
        if not failure_text:
            return result
        failed_trial = replace(
            best, score=replace(best.score, failure=f"commissioning: {failure_text}")
        )
        result = SearchResult.from_trials(
            tuple(failed_trial if trial is best else trial for trial in result.trials)
        )
    return result


@contextmanager
def _exclusive_lock(path: Path) -> Iterator[None]:
    """Lock a journal, so that no second search can use the journal at the same time.

    The lock ends with the process of the search, even after a crash.

    Raises:
        ConfigError: another search has locked the journal, or the file cannot be opened.
    """
    expected = "a new file, or a journal of `tune search`"
    try:
        with path.open("ab") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield
    except BlockingIOError:
        raise ConfigError(
            "another search uses it", str(path), "another --study, or to wait"
        ) from None
    except OSError as error:
        if error.filename != str(path):
            raise
        raise ConfigError(f"cannot be used: {error.strerror}", str(path), expected) from None


def _open_study(plan: SearchPlan, path: Path) -> Any:
    """Open the Optuna study of a search in a journal file. If the file contains no study, create the study.

    Raises:
        ConfigError: the journal cannot be used, or contains another search.
    """
    import optuna
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    try:
        _truncate_partial_line(path)
        journal_storage = JournalStorage(JournalFileBackend(str(path)))
        study = optuna.create_study(
            storage=journal_storage,
            study_name=STUDY_NAME,
            directions=["minimize"] * 3,
            load_if_exists=True,
        )
        _finished_trials(study)
    except (
        OSError,
        ValueError,
        LookupError,
        TypeError,
        AssertionError,
    ) as error:  # Optuna does not check the journal file, so a damaged journal can raise any of the errors below.
        raise ConfigError(
            f"cannot be used: {error}", str(path), "a new file, or a journal of `tune search`"
        ) from None
    if study.user_attrs.get("plan", plan.identity) != plan.identity:
        raise ConfigError(
            "holds another search",
            str(path),
            "the same hand, gains, rate, plants and seed, or a new file",
        )
    study.set_user_attr("plan", plan.identity)
    return study


def _truncate_partial_line(path: Path) -> None:
    """Remove the last line of a journal if the line is incomplete, for example after a power failure.

    Without the removal, Optuna would append its next entry to the incomplete line.

    Raises:
        OSError: the file cannot be read or written.
        ValueError: The file is not a journal. The file stays unchanged.
    """
    if not path.is_file():
        return
    with path.open("r+b") as file:
        content = file.read()
        if content and not content.startswith(b'{"op_code":'):
            raise ValueError("no journal")
        file.truncate(content.rfind(b"\n") + 1)


def _run_batch(
    study: Any,
    plan: SearchPlan,
    workers: SearchWorkers,
    show_result: Callable[[SearchResult], None],
) -> None:
    """Compute the missing scores of the present batch, and report the scores in the order of the trials."""
    finished_count = len(_finished_trials(study))
    trials = _unscored_trials(study, plan, finished_count)[: plan.trials - finished_count]
    jobs = [plan.trial_job(finished_count + i, trial.params) for i, trial in enumerate(trials)]
    scores: dict[int, dict[str, Any]] = {}
    reported_count = 0
    for i, score in workers.compute_scores(jobs):
        scores[i] = score
        while reported_count in scores:
            _report_score(study, trials[reported_count], GainScore(**scores[reported_count]))
            reported_count += 1
            show_result(SearchResult.from_trials(_finished_trials(study)))


def _unscored_trials(study: Any, plan: SearchPlan, finished_count: int) -> list[Any]:
    """Return the trials of the present batch that have no score yet.

    A whole batch is requested from Optuna before the first score of this batch is reported. Because
    of the whole batches, an interrupted or extended search has the same trials as an uninterrupted
    search.
    """
    from optuna.trial import Trial as OptunaTrial
    from optuna.trial import TrialState

    count = BATCH_SIZE - finished_count % BATCH_SIZE
    open_trials = study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))
    # If the whole batch was requested earlier, the batch has the right number of trials, and all
    # its trials have their parameters.
    if len(open_trials) == count and all(
        len(trial.params) == len(GAIN_RANGES) for trial in open_trials
    ):
        return [OptunaTrial(study, trial._trial_id) for trial in open_trials]
    _fail_unfinished_trials(study)
    if finished_count == 0:
        for gains in (plan.gains, *plan.further_gains):
            study.enqueue_trial(clamped_gains(gains))
    study.sampler = _make_sampler(plan.seed, finished_count // BATCH_SIZE)
    return [study.ask(_gain_distributions()) for _ in range(count)]


def _fail_unfinished_trials(study: Any) -> None:
    """Mark queued trials and trials without a score as failed."""
    from optuna.trial import TrialState

    while study.get_trials(deepcopy=False, states=(TrialState.WAITING,)):
        study.ask()
    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        study.tell(trial.number, state=TrialState.FAIL)


def _report_score(study: Any, trial: Any, score: GainScore) -> None:
    """Report the score of a trial to the study."""
    # The score is an attribute of the trial, and is stored before the state of the trial. Therefore
    # every finished trial has a score.
    trial.set_user_attr("score", asdict(score))
    # If an earlier call was interrupted before `tell`, the attribute with the score already exists.
    if not trial.constraints:
        trial.set_constraint("margins", score.shortfall)
    study.tell(trial, list(score.objectives))


def _make_sampler(seed: int, batch: int) -> Any:
    """Return the sampler for a batch of trials."""
    from optuna.samplers import RandomSampler, TPESampler

    # The seed of the study is multiplied by a prime, so that batches of different studies have
    # different seeds.
    batch_seed = (seed * 7919 + batch) % (1 << 31)
    if batch < RANDOM_BATCH_COUNT:
        return RandomSampler(seed=batch_seed)
    return TPESampler(seed=batch_seed, multivariate=True, constant_liar=True)


def _gain_distributions() -> dict[str, Any]:
    """Return the search space as distributions of Optuna."""
    from optuna.distributions import FloatDistribution

    return {
        key: FloatDistribution(gain_range.low, gain_range.high, log=gain_range.is_logarithmic)
        for key, gain_range in GAIN_RANGES.items()
    }


def _finished_trials(study: Any) -> tuple[SearchTrial, ...]:
    """Return the finished trials of a study in order."""
    from optuna.trial import TrialState

    finished_trials = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    return tuple(
        SearchTrial(i, dict(trial.params), GainScore(**trial.user_attrs["score"]))
        for i, trial in enumerate(finished_trials)
    )
