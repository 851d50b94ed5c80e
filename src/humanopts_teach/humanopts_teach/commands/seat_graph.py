"""
The process that runs the graph of one participant's page.

This module imports nothing from the server, so that the page is ready sooner.
"""

from contextlib import suppress
import json
import select
import sys

from humanopts_ros.limits import accept_any_text
from humanopts_teach.commands import CommandError
from humanopts_teach.commands.session import print_line, run_until_interrupt
from humanopts_teach.launching import LaunchError
from humanopts_teach.launching.processes import Setup


def main() -> int:
    """Run the graph described on standard input until the input closes or a signal arrives."""
    accept_any_text()
    setup = Setup.from_json(sys.stdin.readline())

    def check() -> None:
        if select.select([sys.stdin], [], [], 0)[0]:  # the server has closed it or ended
            raise KeyboardInterrupt

    def say(text: str) -> None:
        with suppress(BrokenPipeError):
            print(json.dumps(text), flush=True)

    def report(line: str) -> None:
        print_line(f'{setup.participant}: {line}')

    try:
        return run_until_interrupt(setup, lambda running: say(''), report, check)
    except (LaunchError, CommandError) as error:
        say(str(error).splitlines()[0])
        report(str(error))
        return 1


if __name__ == '__main__':
    sys.exit(main())
