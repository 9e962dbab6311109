"""Where sentences are scored: in this process, or on Ray's actors. Either fills the same cache."""

from __future__ import annotations

from roomtables.errors import MissingExtraError
from roomtables.offline.scoring import Scored, Work, score_locally


def score(work: Work) -> Scored:
    """Score what is to be scored with the engine of the configuration.

    Raises
    ------
    MissingExtraError
        The engine is ``ray`` and Ray is not installed.
    ModelError
        The model cannot be loaded, is another than expected, or gives scores that are not finite.
    StoreError
        A part cannot be written.
    """
    if work.config.engine == "local":
        return score_locally(work)
    try:
        import ray.data  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("`--engine ray`", "ray") from error
    from roomtables.offline.ray_engine import score_on_ray

    return score_on_ray(work)
