"""Which logs a training learns from, stops by and never sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatch

from data_prep.hold import hold_inputs
from data_prep.log import Log
from data_prep.recorded import recorded, with_outputs
from narxcal.errors import ConfigError, DataError
from training.config import SplitConfig


@dataclass(frozen=True)
class Split:
    """Whole logs: to fit to, to stop by, and those that took no part."""

    train: tuple[Log, ...]
    validate: tuple[Log, ...]
    test: tuple[Log, ...]

    def held(self, names: Sequence[str]) -> Split:
        """The logs to learn from with these inputs completed."""
        parts = (self.train, self.validate)
        train, validate = (tuple(hold_inputs(log, names) for log in part) for part in parts)
        return Split(train, validate, self.test)

    def with_outputs(self, outputs: Sequence[str]) -> Split:
        """The split with every output in each log to learn from, NaN where it was not recorded.

        Such an output is learned from the other logs, as where it is masked. Raises `DataError`
        for one that no log to train on has a sample of.
        """
        parts = (self.train, self.validate)
        train, validate = (tuple(with_outputs(log, outputs) for log in part) for part in parts)
        known = {name for log in train for name in recorded(log, outputs)}
        for name in outputs:
            if name not in known:
                raise DataError(
                    "no log to train on has a sample of this output",
                    channel=name,
                    hint="Take it out of [narx] outputs, or add logs that hold it to [split] train",
                )
        return Split(train, validate, self.test)


def split_logs(logs: Sequence[Log], config: SplitConfig) -> Split:
    """Sort logs into sets by their names; `ConfigError` where nothing is left to train on."""
    parts: dict[str, list[Log]] = {"test": [], "validate": [], "train": []}
    patterns = {"test": config.test, "validate": config.validate_, "train": config.train}
    for log in logs:
        for part, chosen in parts.items():
            if any(fnmatch(log.name, pattern) for pattern in patterns[part]):
                chosen.append(log)
                break
        else:
            if not config.test:
                parts["test"].append(log)
    if not parts["train"]:
        raise _nothing_to_train_on([log.name for log in logs], config)
    return Split(tuple(parts["train"]), tuple(parts["validate"]), tuple(parts["test"]))


def _nothing_to_train_on(names: Sequence[str], config: SplitConfig) -> ConfigError:
    meant = [name for name in names if any(fnmatch(name, each) for each in config.train)]
    wanted = f"[split] train = {list(config.train)}"
    if not meant:
        return ConfigError(f"no log matches {wanted}", hint=f"Logs are {', '.join(names)}")
    return ConfigError(
        f"{', '.join(meant)} would match {wanted}, but test or validate came first",
        hint="Leave logs for training there",
    )
