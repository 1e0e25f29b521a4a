"""How good a recording or a result is.

evaluate compares a trajectory with the truth and gives an Evaluation, of each joint a JointScore. Of several people:
fgpose.people.evaluate_people.
"""

from fgpose.assessment.evaluation import Evaluation, JointScore, evaluate

__all__ = [
    "Evaluation",
    "JointScore",
    "evaluate",
]
