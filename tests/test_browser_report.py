"""The report of a study in Chromium: every size and scheme, and what axe finds."""

from collections.abc import Callable
import os
from pathlib import Path

from humanopts_teach.commands.study_report import write_report
from humanopts_teach.study.plan import read_plan
from humanopts_teach.study.record import StudyFolder
import pytest
from teach_support.chromium import DESKTOP, LOOKS, Window, windows
from teach_support.taught_study import Clock, lesson, take_part

pytestmark = [pytest.mark.chromium, pytest.mark.timeout(300)]
__all__ = ['windows']
PICTURES = os.environ.get('PICTURES', '')  # a folder for a picture of the page in each look
EXAMPLE = Path(__file__).parents[1] / 'examples' / 'study' / 'plan.yaml'


def test_the_report_fits_every_screen_and_axe_finds_nothing(
    tmp_path: Path, windows: Callable[..., Window]
) -> None:
    plan, folder, clock = read_plan(EXAMPLE), StudyFolder(tmp_path / 'study'), Clock()
    lessons = [
        {each.name: lesson(plan.conditions[1], seed, error_rate=0.1) for each in plan.conditions}
        for seed in range(4)
    ]
    for number, taught in enumerate(lessons):
        take_part(folder, plan, f'p{number}', taught, clock, most=8 if number == 3 else None)
    page = tmp_path / 'report.html'
    assert write_report(folder, page) == []
    window = windows(DESKTOP)
    window.driver.get(f'file://{page}')
    for size, dark in LOOKS:
        window.look(size, dark)
        width = window.driver.execute_script('return document.documentElement.scrollWidth')
        assert width <= size[0]
        if PICTURES:
            name = f'report-{size[0]}-{"dark" if dark else "light"}.png'
            window.driver.save_screenshot(f'{PICTURES}/{name}')
    assert window.findings() == []
