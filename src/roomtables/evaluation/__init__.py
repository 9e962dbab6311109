"""How often the answer is right: one decision, several compared, a sweep, the paper's tables."""

from roomtables.evaluation.judging import Evaluation, Judged, evaluate

__all__ = ["Evaluation", "Judged", "evaluate"]
