"""Programs that teach by ``LessonClient``: the one of the documentation, and refusals."""

import os
from pathlib import Path
import re
import subprocess
import sys

from graph_support.live import GAME, Graph, LEARNER, LESSON
import pytest

PAGE = Path(__file__).parents[1] / 'docs' / 'how-to' / 'call-the-services.md'
# What is refused before the program of the documentation runs, and after it.
BEFORE = """
from humanopts_teach.lesson.requests import BeginDemonstration, OpenSession, RequestStatus
from humanopts_teach.ros.lesson_client import RefusedError, run_with_lesson


async def teach(client):
    try:
        await client.ask(BeginDemonstration())
    except RefusedError as error:
        print(error.answer.status.name, error)
    try:
        await client.drive('fly')
    except RefusedError as error:
        print(error)
    await client.ask(OpenSession('p1', 's1'))
    print(client.lesson.participant, client.lesson.session)


run_with_lesson(teach)
"""
AFTER = "run_with_lesson(lambda client: client.ask(OpenSession('no code')))"


def run(graph: Graph, program: str) -> tuple[int | None, str, str]:
    """Run a program on the graph; return its exit status, its output and its errors."""
    process = subprocess.Popen(
        [sys.executable, '-c', program],
        env={**os.environ, 'ROS_DOMAIN_ID': str(graph.domain_id)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        graph.until(lambda: process.poll() is not None, 'the end of the program', 60.0)
        return process.returncode, *process.communicate()


@pytest.fixture
def lesson(live: Graph) -> Graph:
    """A game with a learner and a lesson, as the command ``up`` starts them."""
    live.start(GAME)
    live.start(LEARNER, directory=live.folder / 'options', seed=1)
    live.start(
        LESSON,
        directory=live.folder / 'demonstrations',
        strategy='failures',
        until_no_failures=True,
        seed=1,
    )
    live.ready('/game', '/learner', '/lesson')
    return live


def test_the_program_of_the_documentation_teaches_and_what_is_refused_is_raised_with_its_reason(
    lesson: Graph,
) -> None:
    section = PAGE.read_text('utf-8').partition('## Teach from a program')[2]
    program, output = re.findall(r'```(?:python|text)\n(.*?)```', section, re.DOTALL)
    assert 'All criteria hold.' in output
    status, said, errors = run(lesson, BEFORE + program + AFTER)
    assert said.endswith(output)
    first, second, third = said.removesuffix(output).splitlines()
    assert first == 'WRONG_PHASE lesson/begin_demonstration was refused: Open a session to begin.'
    assert second.startswith('action fly was refused: ')
    assert third == 'p1 s1'
    assert status == 1
    assert errors.startswith('Traceback')
    assert "RefusedError: lesson/open_session was refused: participant 'no code'" in errors
