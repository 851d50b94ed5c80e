"""``study check``: what participants see, in order."""

from pathlib import Path

from humanopts_teach.cli import main
from humanopts_teach.commands.study_check import PlanCheck
from humanopts_teach.study.plan import read_plan, StudyPlan
import pytest

EXAMPLES = Path(__file__).parents[3] / 'examples' / 'study'
PLAN = """
consent: consent.md
welcome: welcome.md
practice: true
participants: 4
all: {domain: taxi, task: Bring the passenger to the flag., questions: items.yaml, buttons: 1}
conditions:
  - {name: play, free_play: 2, teach: 0}
  - {name: taught, learn: goal, budget: 3, teach_buttons: [go to passenger and pickup]}
"""
ITEMS = """
points: 12
items:
  - {name: liked, text: Did you like it?, low: no one, high: a lot}
  - {name: one, text: Which one?, kind: choice, options: [this, that]}
  - {name: all, text: Which ones?, kind: choices, options: [this, that, both]}
  - {name: age, text: How old?, kind: number, least: 18, most: 120}
  - {name: more, text: What else?, kind: text}
  - {name: check, text: Choose 11., low: none, high: all, expect: 11}
"""


@pytest.fixture
def plan(tmp_path: Path) -> StudyPlan:
    """A plan with every kind of part and question."""
    for name, text in (
        ('plan.yaml', PLAN),
        ('items.yaml', ITEMS),
        ('consent.md', 'Do you agree?'),
        ('welcome.md', 'First.\n\n---\n\nSecond.'),
    ):
        (tmp_path / name).write_text(text)
    return read_plan(tmp_path / 'plan.yaml')


def test_all_screens_are_shown_in_order_with_times_and_places(
    plan: StudyPlan, tmp_path: Path
) -> None:
    shown = '\n'.join(PlanCheck(plan, tmp_path, 'en').run())
    expected = [
        *('Do you agree?', 'First.', 'Second.', '== play/practice', '== play/play'),
        *('Bring the passenger to the flag.', 'Which button would make', 'Did you like it?'),
        *('Which one?', 'Which ones?', 'How old?', 'What else?', 'Choose 11.', '== taught/teach'),
        *('go to passenger and pickup', 'depend on', ' shown, '),
        *('Did you like it?', 'estimated minutes', 'play, taught: 2 places, about '),
        'taught, play: 2 places, about ',
    ]
    at = 0
    for text in expected:
        assert text in shown[at:]
        at = shown.index(text, at)
    assert 'does not end' not in shown
    other = tmp_path / 'de'
    other.mkdir()
    german = '\n'.join(PlanCheck(plan, other, 'de').run())
    assert 'Do you agree?' in german
    assert 'I agree to take part' in shown
    assert 'I agree to take part' not in german


def test_a_plan_of_the_paper_is_checked(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['study', 'check', str(EXAMPLES / 'paper-buttons.yaml')]) == 0
    out = capsys.readouterr().out
    assert 'taxi: 5 places, about 1' in out
    assert 'pacman: 5 places, about 1' in out
    assert 'note:' not in out
    for path in EXAMPLES.glob('*.yaml'):
        if 'conditions:' in path.read_text():
            read_plan(path)
