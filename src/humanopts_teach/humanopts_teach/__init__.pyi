from .bags import BagError
from .bags.contents import read_demonstrations, read_domain
from .bags.info import summarise
from .bags.reader import Bag, open_bag
from .evaluation.bag_evaluation import BagEvaluation, evaluate_bag
from .lesson.in_process import Taught, teach
from .lesson.seeded_starts import LessonRules
from .lesson.simulated_teacher import SimulatedTeacher, TeacherSettings
from .report.write import write_evaluation_report

__all__ = [
    'Bag',
    'BagError',
    'BagEvaluation',
    'LessonRules',
    'SimulatedTeacher',
    'Taught',
    'TeacherSettings',
    'evaluate_bag',
    'open_bag',
    'read_demonstrations',
    'read_domain',
    'summarise',
    'teach',
    'write_evaluation_report',
]
