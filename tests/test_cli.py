"""The command line: help, one plain line for any bad input, and two launches in one place."""

from collections.abc import Iterator
from importlib.metadata import EntryPoint, version
import json
import os
from pathlib import Path
import pty
import resource
import subprocess
import sys
from typing import Any, get_args, get_type_hints

from graph_support.live import free_domain_id
from humanopts_env.domains import registry
from humanopts_learner.options.starts import STRATEGIES
from humanopts_teach.bags.contents import read_episodes
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.cli import app, main, OUTSIDE
from humanopts_teach.command_line import LaunchOptions
from humanopts_teach.commands.session import check_folder, default_folder
from humanopts_teach.launching.processes import Setup
import pexpect
import pytest
from teach_support.bags import cut_short
import typer

pytestmark = pytest.mark.timeout(300)  # on a busy machine
PAGE = Path(__file__).parents[1] / 'docs/reference/commands.md'
EXPORT = ['export', '--to', 'csv', '--out', '/nowhere']


@pytest.fixture(autouse=True)
def own_domain_id(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Refuse and accept whatever else runs on this machine."""
    with free_domain_id() as number:
        monkeypatch.setenv('ROS_DOMAIN_ID', str(number))
        yield


def run(*arguments: Any) -> int:
    """Run a command in this process and return its exit status."""
    return main([str(argument) for argument in arguments])


def check_refused(capsys: pytest.CaptureFixture[str], status: int, *words: str) -> None:
    """It is bad input: status 2, nothing on standard output, one plain line on standard error."""
    out, err = capsys.readouterr()
    assert (status, out) == (2, '')
    assert err.startswith('humanopts')
    assert err.endswith('\n')
    assert err.count('\n') == 1, err
    for word in words:
        assert word in err


def every_command(command: Any, *path: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield each command with its words, other than those of the repository."""
    yield path, command
    for name, inner in getattr(command, 'commands', {}).items():
        if name not in OUTSIDE:
            yield from every_command(inner, *path, name)


@pytest.mark.parametrize('name', OUTSIDE)
def test_a_command_of_the_repository_says_so_elsewhere(name: str, tmp_path: Path) -> None:
    without = {key: value for key, value in os.environ.items() if key != 'PYTHONPATH'}
    command = [sys.executable, '-m', 'humanopts_teach', name, '--quick']
    done = subprocess.run(command, cwd=tmp_path, env=without, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, '')
    needs = f'{name} needs a clone of the repository: run ./humanopts {name} there'
    assert done.stderr == f'humanopts: {needs}; see humanopts --help\n'


def test_every_command_has_help_and_every_option_is_on_the_page_of_commands(
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = PAGE.read_text('utf-8')
    found = dict(every_command(typer.main.get_command(app)))
    assert len(found) > 14
    for path, command in found.items():
        assert run(*path, '--help') == 0
        out, err = capsys.readouterr()
        assert (' '.join(['humanopts', *path]) in out, err) == (True, '')
        options = [option for param in command.params for option in param.opts]
        assert [option for option in options if option[0] == '-' and option not in page] == []
    assert 'pacman, rooms, taxi' in (run('up', '--help'), capsys.readouterr().out)[1]


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert run('--version') == 0
    assert capsys.readouterr().out.strip() == version('humanopts_teach')


def test_reference_options_that_cannot_be_made_are_bad_input(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    group, find = registry.REFERENCE_OPTIONS, registry._entry_point
    broken = EntryPoint('taxi', 'no_such_module:options', group)
    monkeypatch.setattr(
        registry, '_entry_point', lambda g, n: broken if g == group else find(g, n)
    )
    check_refused(capsys, run('demo', '--domain', 'taxi'), 'no_such_module')


def test_strategies_on_offer_are_those_of_the_learner() -> None:
    """They are named twice, so that help needs no NumPy."""
    hints = get_type_hints(LaunchOptions)
    assert get_args(hints['strategy']) == tuple(STRATEGIES)


PLAN = 'study: s\nseed: 1\nall: {domain: rooms, teach: 1}\nconditions: [{name: a}]\n'


@pytest.mark.parametrize(
    ('command', 'term', 'says'),
    [
        ('teach rooms', 'dumb', 'can move its cursor'),
        ('teach rooms', 'xterm-of-mars', 'this machine does not know'),
        ('study plan.yaml --participant p1', '', 'TERM is not set'),
    ],
)
def test_a_terminal_that_cannot_be_drawn_on_is_refused_before_anything_is_started(
    tmp_path: Path, command: str, term: str, says: str
) -> None:
    (tmp_path / 'plan.yaml').write_text(PLAN)
    with pexpect.spawn(
        sys.executable,
        ['-m', 'humanopts_teach', *command.split()],
        cwd=tmp_path,
        env={**os.environ, 'TERM': term},
        encoding='utf-8',
        timeout=30,
    ) as terminal:
        terminal.expect(pexpect.EOF)
    assert terminal.before is not None
    assert (terminal.exitstatus, terminal.before.count('\n')) == (2, 1), terminal.before
    assert says in terminal.before
    assert [path.name for path in tmp_path.iterdir()] == ['plan.yaml']


OLD_LOCALE = {'PYTHONUTF8': '0', 'PYTHONCOERCECLOCALE': '0', 'LC_ALL': 'C'}
CP1252 = {'PYTHONIOENCODING': 'cp1252'}


def test_any_output_stream_takes_all_that_is_printed(lesson_bag: Path, tmp_path: Path) -> None:
    merge, plan, folder = (tmp_path / name for name in ('merge.yaml', 'plan.yaml', '\u2192'))
    merge.write_text('"größte \u2192 \u201cBeere\u201d": [go to passenger and pickup]\n', 'utf-8')
    plan.write_text(PLAN, 'utf-8')
    folder.mkdir()
    for settings, words, status, expected in (
        (CP1252, ('bag', 'play', lesson_bag), 0, 'step'),
        (CP1252, ('bag', 'table1', lesson_bag, '--merge', merge), 0, 'gr'),
        (OLD_LOCALE, ('study', 'export', plan, '--study', folder), 0, '\\u'),
        (OLD_LOCALE, ('up', 'rooms', '--namespace', '/\u2192'), 2, '\\u'),
    ):
        done = subprocess.run(
            [sys.executable, '-m', 'humanopts_teach', *map(str, words)],
            cwd=tmp_path,
            env={**os.environ, **settings},
            capture_output=True,
            check=False,
        )
        assert (done.returncode, b'Traceback' in done.stderr) == (status, False), done.stderr
        assert expected in (done.stdout + done.stderr).decode('cp1252')


def test_help_is_quick_and_fits_a_terminal() -> None:
    """What takes long is imported by the commands that need it."""
    slow = ('numpy', 'pandas', 'sklearn', 'matplotlib', 'rclpy', 'rich')
    code = (
        'import sys; from humanopts_teach.cli import main\n'
        "for words in ([], ['demo'], ['bag', 'eval'], ['teach']): main([*words, '--help'])\n"
        f'print([name for name in {slow} if name in sys.modules], file=sys.stderr)'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
    assert done.stderr == '[]\n'
    assert max(map(len, done.stdout.splitlines())) <= 80


@pytest.mark.parametrize(
    ('typed', 'offered'),
    [
        ('humanopts de', ['demo']),
        ('humanopts bag ', ['check', 'eval', 'export', 'info', 'play', 'segment', 'table1']),
        ('humanopts demo --strategy ', ['coverage', 'failures', 'random']),
        ('humanopts up taxi --split', ['--split-bytes', '--split-seconds']),
    ],
)
def test_a_shell_completes_what_is_typed(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    typed: str,
    offered: list[str],
) -> None:
    monkeypatch.setenv('_HUMANOPTS_COMPLETE', 'complete_bash')
    monkeypatch.setenv('COMP_WORDS', typed)
    monkeypatch.setenv('COMP_CWORD', str(typed.count(' ')))
    with pytest.raises(SystemExit) as end:
        run()
    out, err = capsys.readouterr()
    assert (end.value.code, sorted(out.split()), err) == (0, offered, '')


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        ((), ['command']),
        (('fly',), ["'fly'", 'demo', 'teach']),
        (('demo', 'extra'), ['extra']),
        (('demo', '--fast'), ['--fast']),
        (('demo', '--episodes', 'many'), ["'many' is not a whole number"]),
        (('demo', '--seed', -1), ['--seed', '-1']),
        (('demo', '--seed', 2**40), ['--seed']),
        (('demo', '--seed'), ['--seed']),
        (('demo', '--initiation-error', 1.5), ['--initiation-error']),
        (('up', 'taxi', '--return-share', 'inf'), ['--return-share', 'inf']),
        (('demo', '--error-rate', 'nan'), ['--error-rate']),
        (('demo', '--strategy', 'luck'), ["'luck'", 'random', 'coverage', 'failures']),
        (('demo', '--domain', 'chess'), ["'chess'", 'taxi']),
        (('demo', '--games', 1), ['--games', 'one game has no interval']),
        (('demo', 'pacman', '--game-steps', 9), ['game_steps is 9', 'at least 400']),
        (('demo', 'gymnasium:FrozenLake-v1'), ['no reference options']),
        (('up',), ['DOMAIN']),
        (('teach', 'taxi', '--linger', 0), ['--linger']),
        (('up', 'taxi', '--joy', '/no/pad.yaml'), ['cannot read /no/pad.yaml']),
        (('up', 'taxi', '--parameter', 'rows=2'), ['rows', '4 to 1000']),
        (('up', 'taxi', '--parameter', 'rows=abc'), ['rows of taxi is "abc"', 'a whole number']),
        (('up', 'taxi', '--parameter', 'nope=1'), ['the parameter nope', 'rows, cols']),
        (
            ('up', 'gymnasium:FrozenLake-v1', '--parameter', 'is_slippery=no'),
            ['is_slippery', 'is "no"', 'true or false'],
        ),
        (('up', 'taxi', '--parameter', 'rows=NaN'), ['not finite']),
        (('up', 'taxi', '--parameter', 'rows'), ["'rows' is not NAME=VALUE"]),
        (('up', 'taxi', '--namespace', 'left'), ["'left' is not a namespace"]),
        (('up', 'taxi', '--only', 'games'), ["unknown node 'games'", 'recorder, game']),
        (('teach', 'taxi', '--browser', '--only', 'game'), ['--only is not for --browser']),
        (('teach', 'taxi'), ['terminal']),
        (('status', '--namespace', 'room'), ["'room' is not a namespace"]),
        (('teach', 'taxi', '--participant', 'J. Doe'), ["'J. Doe' is not a valid code"]),
        (('bag',), ['command']),
        (('bag', 'burn', 'x'), ["'burn'", 'info', 'eval']),
        (('bag', 'info'), ['BAG']),
        (('bag', 'play', 'x', '--speed', 'nan'), ['--speed']),
        (('bag', 'export', 'x', '--out', 'y'), ['--to']),
        (('bag', 'export', 'x', '--to', 'xls', '--out', 'y'), ["'xls'", 'csv']),
        (('bag', 'eval', 'x', 'y', '--html', 'z'), ['--html', 'one bag']),
    ],
    ids=lambda value: ' '.join(map(str, value)),
)
def test_bad_input_is_refused_in_one_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: Any, words: list[str]
) -> None:
    launches = arguments[:1] in (('demo',), ('up',), ('teach',))
    out = ('--out', tmp_path / 'out') if launches and arguments[-1] != '--seed' else ()
    check_refused(capsys, run(*arguments, *out), *words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('number', ['abc', '-1', '233', '1.5'])
def test_bad_ros_domain_id_is_refused(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    number: str,
) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', number)
    check_refused(capsys, run('up', 'taxi', '--out', tmp_path), 'ROS_DOMAIN_ID', repr(number))


def test_output_folder_that_cannot_be_used_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / 'file').write_text('precious')
    for out in (tmp_path / 'file', tmp_path / 'file/below', '/proc/here', tmp_path / ('x' * 300)):
        check_refused(capsys, run('up', 'taxi', '--out', out), f'cannot write in {out}')
    check_refused(capsys, run('demo', '--out', tmp_path), str(tmp_path), 'not empty')
    assert [path.read_text() for path in tmp_path.iterdir()] == ['precious']


def test_output_folder_without_room_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        status = run('demo', '--out', tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    check_refused(capsys, status, f'cannot write in {tmp_path}: File too large')
    assert list(tmp_path.iterdir()) == []


def test_trying_the_output_folder_leaves_the_users_files_alone(tmp_path: Path) -> None:
    (tmp_path / '.probe').write_text('precious')
    check_folder(Setup('taxi', tmp_path))
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [
        ('.probe', 'precious')
    ]


def test_data_of_a_domain_has_a_folder_that_any_path_may_hold() -> None:
    folder = default_folder('gymnasium:ours/Maze-v1')
    assert str(folder) == 'runs/gymnasium-ours-Maze-v1'


def test_what_is_no_bag_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """What else is no bag, and why, is in test_bags_files.py of humanopts_teach."""
    path = tmp_path / 'nowhere'
    for command in (['info'], ['check'], ['eval'], ['play'], ['table1'], EXPORT):
        words = (command[0], path, *command[1:])
        check_refused(capsys, run('bag', *words), str(path), 'there is no bag')


def test_bags_below_a_folder_that_is_none_are_named_the_newest_first(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    bags = [tmp_path / 'bags' / name for name in ('a', 'd', 'b', 'c')]
    for age, bag in enumerate(bags):
        bag.mkdir(parents=True)
        (bag / 'metadata.yaml').touch()
        os.utime(bag, (1e9 - age, 1e9 - age))
    words = f'; the newest bags below it: {bags[0]}, {bags[1]}, {bags[2]}'
    for folder in (tmp_path, tmp_path / 'bags'):
        check_refused(capsys, run('bag', 'info', folder), f'{folder} is not a bag', words)


@pytest.fixture
def half(lesson_bag: Path, tmp_path: Path) -> Path:
    """The first half of a lesson, cut short."""
    return cut_short(lesson_bag, tmp_path / 'half.mcap', 2)


def test_bag_that_was_cut_short_says_so_and_gives_what_is_left(
    capsys: pytest.CaptureFixture[str], half: Path, tmp_path: Path
) -> None:
    assert run('bag', 'info', half) == 0
    out, err = capsys.readouterr()
    assert 'DAMAGED' in out
    assert 'cut short' in out
    assert err == ''
    page = tmp_path / 'nowhere/report.html'
    check_refused(capsys, run('bag', 'eval', half, '--html', page), str(page))
    page = tmp_path / 'report.html'
    assert run('bag', 'eval', half, '--html', page) == 0
    out, err = capsys.readouterr()
    assert 'go to passenger and pickup' in out
    assert 'cut short' in err
    assert err.endswith(f'report: {page}\n')
    assert page.read_text('utf-8').startswith('<!doctype html>')
    half.write_bytes(half.read_bytes()[:2000])
    check_refused(capsys, run('bag', 'eval', half), 'no domain_info', 'cut short')


def test_several_bags_are_evaluated_each_by_itself(
    lesson_bag: Path, capsys: pytest.CaptureFixture[str], half: Path
) -> None:
    assert run('bag', 'eval', half, lesson_bag, '--json') == 0
    out, err = capsys.readouterr()
    first, second = json.loads(out)
    assert first['bag'] == str(half)
    assert first['warnings'] != []
    assert 'cut short' in err
    assert second['bag'] == str(lesson_bag)
    assert second['warnings'] == []


def test_episode_is_played_as_text_where_there_is_no_terminal(
    lesson_bag: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    last = len(list(read_episodes(open_bag(lesson_bag))))
    assert run('bag', 'play', lesson_bag, '--episode', last) == 0
    out = capsys.readouterr().out
    assert f'episode {last} of {last} · step 0' in out
    assert 'go to destination and dropoff: ' in out  # who acted
    assert 'the task is over' in out
    status = run('bag', 'play', lesson_bag, '--episode', last + 1)
    check_refused(capsys, status, f'no episode {last + 1}', f'1 to {last}')


def test_episode_is_played_in_a_terminal_until_q(
    lesson_bag: Path,
) -> None:
    command = ['-m', 'humanopts_teach', 'bag', 'play', str(lesson_bag), '--episode', '3']
    with pexpect.spawn(sys.executable, command, dimensions=(40, 100), timeout=20) as child:
        child.expect('episode 3 of')
        child.send('n')
        child.expect('episode 4 of')
        child.send('q')
        child.expect(pexpect.EOF)
        child.wait()
        assert child.exitstatus == 0


def test_tables_of_a_bag_are_written_and_named_on_standard_output_beside_a_bar_on_the_terminal(
    lesson_bag: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    export = ('bag', 'export', lesson_bag, '--to', 'csv', '--out')
    master, slave = pty.openpty()
    with open(master, 'rb'), open(slave, 'w') as terminal, monkeypatch.context() as shown:
        shown.setattr(sys, 'stderr', terminal)
        assert run(*export, tmp_path / 'new/csv') == 0
        assert os.read(master, 10) != b''
    out, err = capsys.readouterr()
    assert sorted(map(Path, out.split())) == sorted((tmp_path / 'new/csv').iterdir())
    assert err == ''
    assert run(*export, tmp_path / 'plain') == 0
    assert capsys.readouterr().err == ''
    (tmp_path / 'file').touch()
    status = run(*export, tmp_path / 'file')
    check_refused(capsys, status, f'cannot write in {tmp_path / "file"}')


def test_reader_that_stops_reading_ends_the_command_quietly(
    lesson_bag: Path,
) -> None:
    process = subprocess.Popen(
        [sys.executable, '-m', 'humanopts_teach', 'bag', 'info', lesson_bag],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    assert (process.stderr.read(), process.wait(30)) == (b'', 1)


def test_ctrl_z_suspends_a_lesson_that_goes_on_when_it_is_back(
    tmp_path: Path, domain_id: int
) -> None:
    """The shell has its terminal meanwhile; what was shown so far, and control, are kept."""
    lesson = f'{sys.executable} -m humanopts_teach teach rooms --participant p1 --out out'
    terminal = pexpect.spawn(
        'bash',
        ['--norc', '-i'],
        cwd=tmp_path,
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain_id), 'PS1': 'PROMPT ', 'HISTFILE': ''},
        encoding='utf-8',
        dimensions=(30, 100),
        timeout=60,
    )
    with terminal:
        terminal.expect('PROMPT')
        terminal.sendline(lesson)
        terminal.expect('What next')
        terminal.send('1')
        terminal.expect('>')
        terminal.send('go up\r')
        while terminal.expect(['Begin the next', pexpect.TIMEOUT], timeout=0.5):
            terminal.send('y')  # to each question what the option depends on
        terminal.send('\r')
        terminal.expect('Show the option')
        terminal.send('\x1b[D')
        terminal.expect('step 1')
        terminal.send('\x1a')
        terminal.expect('Stopped')
        terminal.expect('PROMPT')
        terminal.sendline('stty -a; jobs; sleep 3; echo "mi"ne')  # longer than control is lent
        terminal.expect(' icanon')
        terminal.expect('Stopped')
        terminal.expect('mine')
        terminal.sendline('fg')
        terminal.expect('step 1')
        terminal.expect('Show the option')
        terminal.send('\x1b[D')
        terminal.expect('step 2')
        terminal.send('\r')
        terminal.expect('1 shown')
        terminal.send('\x1a')
        terminal.expect('PROMPT')
        terminal.sendline('kill %1; fg; echo it ended with $?')
        terminal.expect('it ended with 130', timeout=30)
        terminal.expect('PROMPT')
        terminal.sendline('exit')
        terminal.expect(pexpect.EOF)
    (shown,) = (tmp_path / 'out' / 'demonstrations').glob('*.jsonl')
    assert json.loads(shown.read_text().splitlines()[-1])['actions'] == ['left', 'left']
