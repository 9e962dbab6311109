"""What the process imports from which the runs of `fault_points` are forked."""

import encodings.utf_8_sig  # noqa: F401
import gc

import inflect  # noqa: F401
import pandas  # noqa: F401
import pyarrow.dataset
import pyarrow.pandas_compat  # noqa: F401
import tomllib  # noqa: F401
import tqdm  # noqa: F401

import fault_commands  # noqa: F401
import roomtables.cli.fleet
import roomtables.storage.export  # noqa: F401

gc.collect()
gc.freeze()  # a fork then copies few of the pages that hold what is imported
