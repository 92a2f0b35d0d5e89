"""The search for gains on the twin: Optuna asks in fixed batches and is told in order, so only the seed decides.

Each batch has a sampler of its own, seeded by the study's seed and the batch's number. That makes the result the same
for one process, several and a cluster, and lets a study that was interrupted go on where it stopped: a batch that was
asked goes on with its open trials, one that was asked in part is asked anew.
"""

import fcntl
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from handctl.core.gains.bounds import with_values
from handctl.core.gains.gains import Gains
from handctl.errors import ConfigError
from handctl.tune.search.space import SPACE, within
from handctl.tune.search.workers import Workers
from handctl.tune.trial import Score

BATCH = 8
"""Trials asked at once; more workers than this would wait."""
RANDOM_BATCHES = 2
"""Before the sampler has seen enough to learn from."""
NAME = "handctl"


@dataclass(frozen=True)
class Plan:
    """What a search does.

    Attributes:
        hand: text of its file, which a worker on another machine need not have.
        rate_hz: control rate.
        gains: to begin from; the first trial.
        others: more points to try first, e.g. a design's.
        plants: ensemble of factors.
        seed: of sampler, plants' noise.
        trials: number in all.
    """

    hand: str
    rate_hz: float
    gains: Gains
    plants: tuple[dict[str, float], ...]
    seed: int
    trials: int
    others: tuple[Gains, ...] = ()

    def gains_of(self, number: int, values: Mapping[str, float]) -> Gains:
        """Gains of a trial; those of the first may lie outside of what is searched."""
        return with_values(self.gains, values, "study") if number else self.gains

    def job(self, number: int, values: Mapping[str, float]) -> dict[str, Any]:
        """One trial for a worker; the first is simulated whatever its margins, to compare with."""
        return {
            "hand": self.hand,
            "rate_hz": self.rate_hz,
            "gains": self.gains_of(number, values).model_dump(by_alias=True),
            "plants": list(self.plants),
            "seed": self.seed,
            "must_keep_margins": number > 0,
        }

    @property
    def identity(self) -> str:
        """What must be the same for a study to be continued."""
        plain = {"hand": self.hand, "rate_hz": self.rate_hz, "plants": self.plants, "seed": self.seed}
        return json.dumps(plain | {"gains": self.gains.model_dump(by_alias=True)}, sort_keys=True)


@dataclass(frozen=True, slots=True)
class Trial:
    """A finished trial."""

    number: int
    values: dict[str, float]
    score: Score

    @property
    def good(self) -> bool:
        """Whether it got through and keeps the margins."""
        return not self.score.failure and self.score.shortfall <= 0.0


@dataclass(frozen=True, slots=True)
class Found:
    """Where a search stands.

    Attributes:
        trials: finished ones, in order; the first is of the gains to begin from.
        best: the good one with the least cost; None if none is good.
        front: numbers of the good trials that no other good one beats in every objective.
    """

    trials: tuple[Trial, ...]
    best: Trial | None
    front: tuple[int, ...]

    @staticmethod
    def of(trials: tuple[Trial, ...]) -> "Found":
        """Judge trials."""
        good = [one for one in trials if one.good]
        best = min(good, key=lambda one: (one.score.cost(_scale(trials)), one.number)) if good else None
        front = [one.number for one in good if not any(_beats(other.score, one.score) for other in good)]
        return Found(trials, best, tuple(front))

    def cost(self, trial: Trial) -> float:
        """Cost of a trial in terms of the first; of the first good one if that failed."""
        return trial.score.cost(_scale(self.trials))


def _scale(trials: tuple[Trial, ...]) -> Score:
    """What costs are multiples of."""
    first, good = trials[0].score, (one.score for one in trials if one.good)
    return next(good, first) if first.failure else first


def _beats(one: Score, other: Score) -> bool:
    pairs = list(zip(one.objectives, other.objectives, strict=True))
    return all(a <= b for a, b in pairs) and any(a < b for a, b in pairs)


def search(plan: Plan, storage: Path, crew: Workers, show: Callable[[Found], None]) -> Found:
    """Run a search, or go on with it.

    Args:
        plan: what to search.
        storage: Optuna journal; a new file, or one of the same plan.
        crew: who computes.
        show: called after each trial.

    Raises:
        ConfigError: the storage holds another search, or another process uses it.
    """
    with _alone(storage):
        study = _study(plan, storage)
        while len(_finished(study)) < plan.trials:
            _batch(study, plan, crew, show)
        return Found.of(_finished(study))


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Keep other searches from a journal; the system lets go of it when this process ends, however that is.

    Raises:
        ConfigError: another search has it, or it cannot be opened.
    """
    right = "a new file, or a journal of `tune search`"
    try:
        with path.open("ab") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield
    except BlockingIOError:
        raise ConfigError("another search uses it", str(path), "another --study, or to wait") from None
    except OSError as error:
        if error.filename != str(path):
            raise
        raise ConfigError(f"cannot be used: {error.strerror}", str(path), right) from None


def _study(plan: Plan, path: Path) -> Any:
    import optuna
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    try:
        _mend(path)
        backend = JournalStorage(JournalFileBackend(str(path)))
        study = optuna.create_study(storage=backend, study_name=NAME, directions=["minimize"] * 3, load_if_exists=True)
        _finished(study)
    except (OSError, ValueError, LookupError, TypeError, AssertionError) as error:  # Optuna reads without looking
        raise ConfigError(f"cannot be used: {error}", str(path), "a new file, or a journal of `tune search`") from None
    if study.user_attrs.get("plan", plan.identity) != plan.identity:
        raise ConfigError(
            "holds another search", str(path), "the same hand, gains, rate, plants and seed, or a new file"
        )
    study.set_user_attr("plan", plan.identity)
    return study


def _mend(path: Path) -> None:
    """Take away a last line that was not written to its end, as by a power cut: Optuna would write on behind it.

    Raises:
        OSError: it cannot be read or written.
        ValueError: it is no journal, and is left as it is.
    """
    if not path.is_file():
        return
    with path.open("r+b") as file:
        content = file.read()
        if content and not content.startswith(b'{"op_code":'):
            raise ValueError("no journal")
        file.truncate(content.rfind(b"\n") + 1)


def _batch(study: Any, plan: Plan, crew: Workers, show: Callable[[Found], None]) -> None:
    """Compute what the present batch lacks, and tell in the order in which it was asked."""
    done = len(_finished(study))
    asked = _asked(study, plan, done)[: plan.trials - done]
    jobs = [plan.job(done + i, trial.params) for i, trial in enumerate(asked)]
    scores: dict[int, dict[str, Any]] = {}
    told = 0
    for i, score in crew.scores(jobs):
        scores[i] = score
        while told in scores:
            _tell(study, asked[told], Score(**scores[told]))
            told += 1
            show(Found.of(_finished(study)))


def _asked(study: Any, plan: Plan, done: int) -> list[Any]:
    """Open trials of the present batch: all of it is asked before any of it is told, whatever number is wanted now.

    Who wants more later, or comes after an interruption, so finds those that one run would have asked.
    """
    from optuna.trial import Trial as Asked
    from optuna.trial import TrialState

    count = BATCH - done % BATCH
    still_open = study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))
    if len(still_open) == count and all(len(one.params) == len(SPACE) for one in still_open):
        return [Asked(study, one._trial_id) for one in still_open]
    _forget(study)
    if done == 0:
        for gains in (plan.gains, *plan.others):
            study.enqueue_trial(within(gains))
    study.sampler = _sampler(plan.seed, done // BATCH)
    return [study.ask(_distributions()) for _ in range(count)]


def _forget(study: Any) -> None:
    """Close what is queued or open."""
    from optuna.trial import TrialState

    while study.get_trials(deepcopy=False, states=(TrialState.WAITING,)):
        study.ask()
    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        study.tell(trial.number, state=TrialState.FAIL)


def _tell(study: Any, trial: Any, score: Score) -> None:
    trial.set_user_attr("score", asdict(score))
    if not trial.constraints:  # it has them if an interruption came between the next line and this one
        trial.set_constraint("margins", score.shortfall)
    study.tell(trial, list(score.objectives))


def _sampler(seed: int, batch: int) -> Any:
    from optuna.samplers import RandomSampler, TPESampler

    own = (seed * 7919 + batch) % (1 << 31)
    if batch < RANDOM_BATCHES:
        return RandomSampler(seed=own)
    return TPESampler(seed=own, multivariate=True, constant_liar=True)


def _distributions() -> dict[str, Any]:
    from optuna.distributions import FloatDistribution

    return {key: FloatDistribution(one.low, one.high, log=one.log) for key, one in SPACE.items()}


def _finished(study: Any) -> tuple[Trial, ...]:
    from optuna.trial import TrialState

    done = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    return tuple(Trial(i, dict(one.params), Score(**one.user_attrs["score"])) for i, one in enumerate(done))
