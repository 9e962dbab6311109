"""``python -m roomtables``."""

from roomtables.cli import main

main()
