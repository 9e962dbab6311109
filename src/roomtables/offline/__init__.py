"""The offline wing: makes tables."""
