"""Everything that touches the disk: versions, the mapped lookup, scores, misses, SQL views."""
