"""What a build is asked to do: ``build.toml`` plus options, as one frozen dataclass."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from roomtables.errors import ConfigError, LabelSpaceError
from roomtables.labels import LabelSpace
from roomtables.schemas import REDUCTIONS, RULES, SOURCES
from roomtables.scorer import DTYPES, SCORINGS
from roomtables.sentences import DEFAULT_TEMPLATE, Template

ENGINES = ("local", "ray")
_CHOICES = {
    "dtype": DTYPES,
    "reduction": REDUCTIONS,
    "rule": RULES,
    "source": SOURCES,
    "engine": ENGINES,
    "scoring": (None, *SCORINGS),
}
_PATHS = ("counts", "scores")


def pipeline_folder() -> Path:
    """Where the pipeline lives: inside an installed package, or in the checkout."""
    package = Path(__file__).parent
    installed = package / "pipeline"
    return installed if installed.is_dir() else package.parents[1] / "pipeline"


def load_labels(name_or_folder: str) -> LabelSpace:
    """A label space: a folder of the user's own, or a built-in one by name.

    Raises
    ------
    LabelSpaceError
        There is no such folder and no such built-in label space.
    InputError
        A file of the folder is malformed.
    """
    if Path(name_or_folder).is_dir():
        return LabelSpace.load(Path(name_or_folder))
    builtin = pipeline_folder() / "labels"
    if name_or_folder in builtin_labels():
        return LabelSpace.load(builtin / name_or_folder)
    raise LabelSpaceError(
        f"no label space {name_or_folder!r}: neither a folder nor one of "
        f"{', '.join(builtin_labels())}; run `roomtables labels list`"
    )


def builtin_labels() -> tuple[str, ...]:
    """The names of the built-in label spaces, sorted."""
    folder = pipeline_folder() / "labels"
    return tuple(sorted(path.name for path in folder.iterdir() if path.is_dir()))


@dataclass(frozen=True)
class BuildConfig:
    """Everything that decides what a build writes.

    Raises
    ------
    ConfigError
        A value is of the wrong type or outside its range.
    """

    labels: str = "mpcat40"
    model: str = "household-lm"
    revision: str | None = None
    dtype: str = "float32"
    device: str = "auto"
    scoring: str | None = None
    token_budget: int | None = None
    template: str = DEFAULT_TEMPLATE
    reduction: str = "sum"
    smoothing: float | None = None
    k: int = 3
    combinations: str = "all"
    source: str = "proxy"
    rule: str = "query"
    prior_weight: float = 0.5
    evidence_power: float = 3.0
    counts: Path | None = None
    scores: Path | None = None
    engine: str = "local"
    workers: int = 0
    full_refresh: bool = False
    stages: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                allowed = ", ".join(str(choice) for choice in choices if choice)
                raise ConfigError(f"{name} must be one of {allowed}, not {getattr(self, name)!r}")
        if not 1 <= self.k <= 8:
            raise ConfigError(f"k must be from 1 to 8, not {self.k}")
        if self.smoothing is not None and not 0 <= self.smoothing < float("inf"):
            raise ConfigError(f"smoothing must be 0 or more, not {self.smoothing}")
        if self.token_budget is not None and self.token_budget < 1:
            raise ConfigError(f"token_budget must be 1 or more, not {self.token_budget}")
        if self.workers < 0:
            raise ConfigError(f"workers must be 0 (as many as fit) or more, not {self.workers}")
        check_decision(self.prior_weight, self.evidence_power)
        Template(self.template)

    @classmethod
    def load(cls, path: Path | None = None, **options: Any) -> BuildConfig:
        """Defaults of the package, then the file, then options that are not ``None``.

        Raises
        ------
        ConfigError
            The file cannot be read, is not TOML, or holds an unknown key or a wrong value.
        """
        values = _read_toml(pipeline_folder() / "build.toml")
        if path is not None:
            values |= _read_toml(path)
        values |= {name: value for name, value in options.items() if value is not None}
        return cls(**{name: _typed(name, value, path) for name, value in values.items()})


def check_decision(prior_weight: float, evidence_power: float) -> None:
    """Refuse a λ or γ that makes no sense.

    Raises
    ------
    ConfigError
        λ is not finite, or γ is negative or not finite.
    """
    if not abs(prior_weight) < float("inf"):
        raise ConfigError(f"prior weight must be finite, not {prior_weight}")
    if not 0 <= evidence_power < float("inf"):
        raise ConfigError(f"evidence power must be 0 or more, not {evidence_power}")


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # not TOML, not UTF-8, or thousands of digits
        raise ConfigError(f"{path}: not valid TOML: {error}") from error


_TYPES: Mapping[str, tuple[type, ...]] = {
    "k": (int,),
    "token_budget": (int,),
    "workers": (int,),
    "smoothing": (int, float),
    "prior_weight": (int, float),
    "evidence_power": (int, float),
    "full_refresh": (bool,),
    "stages": (list, tuple),
}


def _typed(name: str, value: Any, path: Path | None) -> Any:
    """The value as its field holds it, or an error that names key and file."""
    where = path or "build.toml"
    if name not in {known.name for known in fields(BuildConfig)}:
        raise ConfigError(f"{where}: unknown key `{name}`")
    expected: tuple[type, ...] = _TYPES.get(name, (str, Path))
    fits = isinstance(value, expected) and (expected == (bool,) or not isinstance(value, bool))
    if not fits:
        raise ConfigError(f"{where}: `{name}` must be {expected[0].__name__}, not {value!r}")
    if name in _PATHS:
        return Path(value)
    if name == "stages":
        return tuple(value)
    return float(value) if float in expected else value
