from .automatic.extract import find_options, to_learned_options
from .demonstration_table import (
    demonstrations_from_table,
    demonstrations_to_table,
)
from .demonstrations import Demonstration, make_demonstration
from .execution import Fixed, play, RowOptions
from .option import Option
from .options.accuracy import classification_accuracy, policy_accuracy
from .options.files import load_option, save_option
from .options.judge import judge, Thresholds
from .options.learn import learn_option
from .options.learned_option import LearnedOption
from .options.starts import choose_start_state
from .planning.plan import judge_plan, plan
from .planning.solve import solve_smdp
from .summary import OptionSummary

__all__ = [
    'Demonstration',
    'Fixed',
    'LearnedOption',
    'Option',
    'OptionSummary',
    'RowOptions',
    'Thresholds',
    'choose_start_state',
    'classification_accuracy',
    'demonstrations_from_table',
    'demonstrations_to_table',
    'find_options',
    'judge',
    'judge_plan',
    'learn_option',
    'load_option',
    'make_demonstration',
    'plan',
    'play',
    'policy_accuracy',
    'save_option',
    'solve_smdp',
    'to_learned_options',
]
