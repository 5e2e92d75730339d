"""A robot cell that is not ours: PyBullet's Panda, contacts and pictures, on Repose's keys.

Repose knows nothing of what is in here. The cell serves the keys of one robot and one camera and nothing else; what came of a placement is
judged by PyBullet's poses. `scripts/foreign_world.py` runs trials in it.
"""
