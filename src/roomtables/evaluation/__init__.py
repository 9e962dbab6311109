"""How often the answer is right: judging, comparing, sweeping, and the paper's own conditions."""

from roomtables.evaluation.judging import Evaluation, Judged, evaluate

__all__ = ["Evaluation", "Judged", "evaluate"]
