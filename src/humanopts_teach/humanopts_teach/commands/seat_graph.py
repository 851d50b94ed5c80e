"""
The process that keeps the graph of one participant's page.

It is a module of its own, so that it imports nothing of the server's: the page is there sooner.
"""

from contextlib import suppress
import json
import select
import sys

from humanopts_ros.limits import accept_any_text
from humanopts_teach.commands import CommandError
from humanopts_teach.commands.session import print_line, session
from humanopts_teach.launching import LaunchError
from humanopts_teach.launching.processes import Setup
from humanopts_teach.ros.graph_client import GraphClient


def main() -> int:
    """Run the graph that standard input describes, until its end or a signal."""
    accept_any_text()
    namespace, setup = sys.stdin.readline().rstrip('\n'), Setup.from_json(sys.stdin.readline())

    def check(*_: GraphClient) -> None:
        if select.select([sys.stdin], [], [], 0)[0]:  # the server has closed it, or is gone
            raise KeyboardInterrupt

    def say(text: str) -> None:
        with suppress(BrokenPipeError):
            print(json.dumps(text), flush=True)

    def report(line: str) -> None:
        print_line(f'{setup.participant}: {line}')

    running = None
    try:
        with session(setup, namespace, check, report) as running:
            say('')
            running.stay(report, check)
    except (LaunchError, CommandError) as error:
        say(str(error).splitlines()[0])
        report(str(error))
        return 1
    except KeyboardInterrupt:
        pass
    return 0 if running is None else running.end()


if __name__ == '__main__':
    sys.exit(main())
