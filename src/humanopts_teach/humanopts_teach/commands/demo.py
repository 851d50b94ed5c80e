"""``humanopts demo``: the whole graph with a simulated teacher, a bag and a report."""

import argparse
from pathlib import Path

from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_teach.commands.errors import CommandError
from humanopts_teach.commands.progress import DemoProgress
from humanopts_teach.commands.session import check_setup, Session, session
from humanopts_teach.commands.setup import new_name, setup_from
from humanopts_teach.launching.processes import Setup

# What the paper's participants were asked to teach (section 7).
TAUGHT = {
    'taxi': ('go to passenger and pickup', 'go to destination and dropoff'),
}
_TEACHING_SECONDS = 600.0


def run(arguments: argparse.Namespace) -> int:
    """Teach, plan, play, evaluate the bag, and report; status 0 when everything came out."""
    setup = setup_from(
        arguments,
        Path('runs') / new_name('demo'),
        taught=taught_options(arguments),
        teacher_error_rate=arguments.error_rate,
    )
    if setup.directory.is_dir() and any(setup.directory.iterdir()):
        raise CommandError(f'{setup.directory} is not empty; choose another --out')
    check_setup(setup)
    with DemoProgress() as progress:
        with session(setup, arguments.namespace, progress) as running:
            live = teach_plan_play(running, setup, arguments.episodes, progress)
        return finish(setup, live, progress)
