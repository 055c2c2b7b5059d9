"""Fresh matches of a policy, and what they say."""

from fbrl.evaluation.evaluation import Evaluation, evaluate, play_matches
from fbrl.evaluation.policies import make_policy

__all__ = ["Evaluation", "evaluate", "make_policy", "play_matches"]
