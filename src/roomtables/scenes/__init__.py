"""Scene graphs and room lists, in and out: one module per format, in a table in `reader`."""

from roomtables.scenes.reader import read_rooms, read_scene, read_scenes

__all__ = ["read_rooms", "read_scene", "read_scenes"]
