"""What a build is asked to do: ``build.toml`` plus options, as one frozen dataclass."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from roomtables.errors import ConfigError, InputError, LabelSpaceError
from roomtables.labels import LABEL_FILES, LabelSpace
from roomtables.limits import LARGEST_COUNT
from roomtables.schemas import REDUCTIONS, RULES, SCORED, SENTENCE, SOURCES
from roomtables.scorer import DTYPES, SCORINGS
from roomtables.sentences import DEFAULT_TEMPLATE, check_templates

DEFAULT_LABELS = "household"
MOST_PRIOR_WEIGHT = 1e6
MOST_EVIDENCE_POWER = 100.0
ENGINES = ("local", "ray")
# What a build may put into the tables besides the rooms of a file; `auto` is `all` or `misses`.
AUTO, ALL, NONE, MISSES = "auto", "all", "none", "misses"
_CHOICES = {
    "dtype": DTYPES,
    "scored": SCORED,
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


def labels_folder(name_or_folder: str) -> Path | None:
    """The folder of label files that ``--labels`` means, whether or not it is there.

    A bare name is the built-in label space of that name, else a folder of label files; ``None``
    where it is neither: then it can only be a published one. Whatever holds a slash, and ``.`` and
    ``..``, is a folder.
    """
    folder = Path(name_or_folder)
    if folder.name != name_or_folder or name_or_folder in {"", ".."}:
        return folder
    if name_or_folder in builtin_labels():
        return pipeline_folder() / "labels" / name_or_folder
    try:
        found = any((folder / name).exists() for name in LABEL_FILES)
    except OSError:  # whoever reads it says why
        found = True
    return folder if found else None


def labels_name(name_or_folder: str) -> str:
    """The name of the label space that ``--labels`` means: its folder's under the tables."""
    folder = labels_folder(name_or_folder)
    return name_or_folder if folder is None else folder.resolve().name


def load_labels(name_or_folder: str) -> LabelSpace:
    """A label space that is built in or a folder, as :func:`labels_folder` tells them apart.

    Raises
    ------
    LabelSpaceError
        There is no such folder and no such built-in label space.
    InputError
        The folder cannot be read, or a file of it is malformed.
    """
    folder = labels_folder(name_or_folder)
    try:
        if folder is not None and folder.is_dir():
            return LabelSpace.load(folder)
    except OSError as error:
        raise InputError(
            f"cannot read label space {name_or_folder}: {error.strerror}; see who may read it"
        ) from error
    raise LabelSpaceError(
        f"no label space {name_or_folder!r}: neither a folder with {' and '.join(LABEL_FILES)} nor "
        f"one of {', '.join(builtin_labels())}; run `roomtables labels list`"
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

    labels: str = DEFAULT_LABELS
    model: str = "household-lm"
    revision: str | None = None
    dtype: str = "float32"
    device: str = "auto"
    scoring: str | None = None
    token_budget: int | None = None
    template: tuple[str, ...] = (DEFAULT_TEMPLATE,)
    scored: str = SENTENCE
    reduction: str = "sum"
    smoothing: float | None = None
    k: int = 3
    combinations: str = AUTO
    source: str = "proxy"
    rule: str = "query"
    prior_weight: float = 0.5
    evidence_power: float = 3.0
    counts: Path | None = None
    scores: Path | None = None
    engine: str = "local"
    workers: int = 0
    full_refresh: bool = False
    stages: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                allowed = ", ".join(str(choice) for choice in choices if choice)
                found = repr(getattr(self, name))[:80]
                raise ConfigError(f"{name} must be one of {allowed}, not {found}")
        if not 1 <= self.k <= 8:
            raise ConfigError(f"k must be from 1 to 8, not {self.k}")
        if self.smoothing is not None and not 0 <= self.smoothing < float("inf"):
            raise ConfigError(f"smoothing must be 0 or more, not {self.smoothing}")
        if self.token_budget is not None and self.token_budget < 1:
            raise ConfigError(f"token_budget must be 1 or more, not {self.token_budget}")
        if self.workers < 0:
            raise ConfigError(f"workers must be 0 (as many as fit) or more, not {self.workers}")
        check_decision(self.prior_weight, self.evidence_power)
        check_templates(self.template, self.scored)

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
        return cls.of(values, path or "build.toml")

    @classmethod
    def of(cls, values: Mapping[str, Any], where: Path | str) -> BuildConfig:
        """Settings by name, each checked for its type; ``where`` they stand, for the message.

        Raises
        ------
        ConfigError
            A name is no setting, or a value is of the wrong type or outside its range.
        """
        return cls(**{name: _typed(name, value, where) for name, value in values.items()})

    @classmethod
    def recorded_names(cls) -> frozenset[str]:
        """The settings that a manifest records.

        Left out are ``stages``, which a manifest records with what each of them read, and
        ``full_refresh``, which says how to build and not what.
        """
        return _NAMES - {"stages", "full_refresh"}

    def recorded(self) -> dict[str, Any]:
        """The settings as a manifest records them: by name, as JSON holds values."""
        values = {name: getattr(self, name) for name in self.recorded_names()}
        paths = {name: str(value) for name, value in values.items() if isinstance(value, Path)}
        return values | paths | {"template": list(self.template)}

    def changed(self, **options: Any) -> BuildConfig:
        """The settings with some replaced, by name.

        Raises
        ------
        ConfigError
            As :meth:`of`.
        """
        return replace(self, **{n: _typed(n, v, "build options") for n, v in options.items()})


def check_decision(prior_weight: float, evidence_power: float) -> None:
    """Refuse a λ or γ that makes no sense.

    Raises
    ------
    ConfigError
        λ or γ is so large that sums overflow, or no number, or γ is negative.
    """
    if not abs(prior_weight) <= MOST_PRIOR_WEIGHT:
        most = f"{MOST_PRIOR_WEIGHT:,.0f}"
        raise ConfigError(f"prior weight must be from -{most} to {most}, not {prior_weight}")
    if not 0 <= evidence_power <= MOST_EVIDENCE_POWER:
        raise ConfigError(
            f"evidence power must be from 0 to {MOST_EVIDENCE_POWER:.0f}, not {evidence_power}"
        )


def default_stages() -> dict[str, tuple[str, ...]]:
    """The stages of the package's ``build.toml``: each stage's name, and what it reads."""
    path = pipeline_folder() / "build.toml"
    stages: dict[str, tuple[str, ...]] = _typed("stages", _read_toml(path)["stages"], path)
    return stages


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        tomllib = import_module("tomllib")  # a lookup reads no TOML
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"cannot read {path}: settings in TOML need Python 3.11 or newer; build there, then "
            "take the tables here with `roomtables export`"
        ) from error
    try:
        values: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
        return values
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # not TOML, not UTF-8, or thousands of digits
        raise ConfigError(f"{path}: not valid TOML: {error}") from error


_NAMES = frozenset(known.name for known in fields(BuildConfig))
_TYPES: Mapping[str, tuple[type, ...]] = {
    "k": (int,),
    "token_budget": (int,),
    "workers": (int,),
    "smoothing": (float, int),
    "prior_weight": (float, int),
    "evidence_power": (float, int),
    "full_refresh": (bool,),
    "template": (str, list, tuple),
}
_OPTIONAL = frozenset(known.name for known in fields(BuildConfig) if known.default is None)


def _typed(name: str, value: Any, where: Path | str) -> Any:
    """The value as its field holds it, or an error that names key and file."""
    if name not in _NAMES:
        raise ConfigError(f"{where}: unknown key `{name[:40]}`")
    if name == "stages":
        return _stages(value, where)
    if value is None and name in _OPTIONAL:
        return None
    expected: tuple[type, ...] = _TYPES.get(name, (str, Path))
    fits = isinstance(value, expected) and (expected == (bool,) or not isinstance(value, bool))
    if isinstance(value, int) and abs(value) > LARGEST_COUNT:  # may be too long to be written
        raise ConfigError(f"{where}: `{name}` must be at most {LARGEST_COUNT:,.0f}")
    if not fits:
        shown = repr(value)[:80]
        raise ConfigError(f"{where}: `{name}` must be {expected[0].__name__}, not {shown}")
    if name in _PATHS:
        return Path(value)
    if name == "template":
        return _texts(name, [value] if isinstance(value, str) else value, where)
    return float(value) if float in expected else value


def _stages(value: Any, where: Path | str) -> dict[str, tuple[str, ...]]:
    if not isinstance(value, Mapping):
        raise ConfigError(
            f"{where}: `stages` must be a table that says what each stage reads; "
            "copy `[stages]` from the package's build.toml"
        )
    return {str(stage): _texts(f"stages.{stage}", reads, where) for stage, reads in value.items()}


def _texts(name: str, value: Any, where: Path | str) -> tuple[str, ...]:
    if not isinstance(value, list | tuple) or not all(isinstance(text, str) for text in value):
        raise ConfigError(f"{where}: `{name}` must be a list of strings, not {value!r}"[:500])
    return tuple(value)
