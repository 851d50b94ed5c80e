"""The teaching session: its questions, records and views, without ROS."""

from typing import Final

STRATEGY: Final = 'failures'  # default strategy for start states
METHOD: Final = 'trees'  # default learning method
BUDGET = 150  # maximum number of start states per option, including "not here" answers
