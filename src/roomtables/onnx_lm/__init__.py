"""Log probabilities of whole sentences from an ONNX file: the language model of a robot.

ONNX Runtime and ``tokenizers`` do the work; neither torch nor transformers is needed, and both
packages are imported when a file is opened. ``roomtables.lm`` makes the files.
"""

from roomtables.onnx_lm.facts import MODEL_FILE, TOKENIZER_FILE
from roomtables.onnx_lm.scorer import OnnxScorer

__all__ = ["MODEL_FILE", "TOKENIZER_FILE", "OnnxScorer"]
