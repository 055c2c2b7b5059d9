"""What is logged while training: every TensorBoard name, and the files of a run."""

from fbrl.monitor.recent_matches import MATCHES_IN_MEAN
from fbrl.monitor.scalars import BALL_POSITIONS, IMAGES, MATCH_VIDEO, SCALARS
from fbrl.monitor.writer import Monitor

__all__ = ["BALL_POSITIONS", "IMAGES", "MATCHES_IN_MEAN", "MATCH_VIDEO", "SCALARS", "Monitor"]
