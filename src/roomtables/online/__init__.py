"""The online wing: reads tables, decides rooms."""
