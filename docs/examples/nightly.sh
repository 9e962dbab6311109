#!/bin/sh
# What a night does to a tables folder: build, tidy up, say what changed and what is published.
#     nightly.sh /srv/rooms
# Ends with the exit code of the first command that fails; roomtables must be on the PATH.
set -eu
tables=${1:?which tables folder?}

roomtables build --tables "$tables" --wait
roomtables compact --tables "$tables"
roomtables gc --tables "$tables"
# The first night has no version before.
roomtables diff --tables "$tables" --top 20 || true
roomtables status --tables "$tables" --max-age 26h
