"""Options shared by commands, and their parsers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, MISSING
import inspect
import os
from pathlib import Path
from typing import Annotated, Any, Literal

from humanopts_ros.recording import MAX_BYTES
from humanopts_teach.lesson import BUDGET, METHOD, STRATEGY
import typer
from typer.core import TyperCommand, TyperGroup

PLAIN: dict[str, Any] = {  # settings of every Typer app: plain help that fits 80 columns
    'rich_markup_mode': None,
    'pretty_exceptions_enable': False,
    'add_completion': False,
    'context_settings': {'help_option_names': ['-h', '--help'], 'max_content_width': 80},
}


def option(
    metavar: str, text: str, parser: Callable[[str], Any] | None = None, **more: Any
) -> Any:
    """Return an option with a value; ``more`` is passed to Typer."""
    return typer.Option(metavar=metavar, help=text, parser=parser, **more)


def flag(name: str, text: str, **more: Any) -> Any:
    """Return a flag; ``more`` is passed to Typer."""
    return typer.Option(name, help=text, **more)


ExcelOption = Annotated[
    bool, flag('--excel', 'begin CSV files with a byte order mark, as Excel needs')
]
_UNITS = {'': 1, 'k': 10**3, 'M': 10**6, 'G': 10**9}


def number(what: str, accepted: Callable[[Any], bool], kind: type = float) -> Callable[[str], Any]:
    """
    Return a parser of numbers.

    :param what: description of the accepted numbers; completes the message "... is not".
    """

    def parse(text: str) -> Any:
        try:
            value = kind(text)
        except ValueError:
            called = 'a number' if kind is float else 'a whole number'
            raise typer.BadParameter(f'{text!r} is not {called}') from None
        if not accepted(value):
            raise typer.BadParameter(f'{text} is not {what}')
        return value

    return parse


def whole(least: int) -> Callable[[str], int]:
    """Return a parser of integers from ``least`` to 2**31 - 1."""
    return number(f'from {least} to {2**31 - 1}', lambda value: least <= value < 2**31, int)


def size(text: str) -> int:
    """Parse a size such as 500M and return it in bytes."""
    digits = text.rstrip('kMG')
    unit = _UNITS.get(text[len(digits) :])
    value = int(digits) * unit if unit and digits.isascii() and digits.isdigit() else 0
    if not 0 < value <= MAX_BYTES:
        raise typer.BadParameter(f'{text!r} is not a size such as 500M')
    return value


def name_and_value(text: str) -> tuple[str, Any]:
    """Parse a domain parameter such as rows=7 and return its name and value."""
    from humanopts_env.domains.base import DomainError  # slow to import
    from humanopts_env.domains.parameters import parameter_from_text

    name, equals, value = text.partition('=')
    if not (name and equals):
        raise typer.BadParameter(f'{text!r} is not NAME=VALUE')
    try:
        return name, parameter_from_text(value)
    except DomainError as error:
        raise typer.BadParameter(str(error)) from error


def each_once(pairs: list[Any]) -> list[Any]:
    """Reject duplicate parameters: one of the values would be lost silently."""
    names = [name for name, _ in pairs]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise typer.BadParameter(f'{", ".join(twice)} is given twice')
    return pairs


def several_games(count: int | None) -> int | None:
    """Check a number of games: one game has no confidence interval."""
    if count == 1:
        raise typer.BadParameter('one game has no interval; give 0, or 2 or more')
    return count


share = number('from 0 to below 1', lambda value: 0 <= value < 1)
seconds = number('from 0 to 60', lambda value: 0 <= value <= 60)


OnlyOption = Annotated[
    str,
    option(
        'NAMES',
        'nodes to start here, such as game,lesson,recorder, while the others run on another '
        'machine; default: all',
        show_default=False,
    ),
]


@dataclass(frozen=True)
class PageOptions:
    """Options of the page server, one per field."""

    browser: Annotated[bool, flag('--browser', 'serve pages to one or several people')] = False
    host: Annotated[
        str,
        option('ADDRESS', 'with --browser: address to serve at; 0.0.0.0: all'),
    ] = '127.0.0.1'
    port: Annotated[
        int,
        option('N', 'with --browser: port; 0: any free one', min=0, max=65535),
    ] = 8080
    allow_host: Annotated[
        list[str],
        option(
            'NAME',
            'with --browser: a host name by which browsers reach this machine, such as that '
            'of a reverse proxy; may be repeated',
        ),
    ] = field(default_factory=list)
    seats: Annotated[
        int | None,
        option(
            'N',
            'with --browser: maximum number of games at once; more people wait in line; '
            'default: as many as fit in memory',
            whole(1),
        ),
    ] = None
    linger: Annotated[
        float,
        option(
            'SECONDS',
            'with --browser: how long a game continues after its page is closed',
            number('from 1 to 86400', lambda value: 1 <= value <= 86400),
        ),
    ] = 120.0


@dataclass(frozen=True, kw_only=True)
class DomainOptions:
    """Options of the domain, one per field."""

    parameter: Annotated[
        list[Any],  # pairs of name and value
        option(
            'NAME=VALUE',
            'parameter of the domain, such as rows=7 or is_slippery=false; may be repeated',
            name_and_value,
            callback=each_once,
        ),
    ] = field(default_factory=list)
    features: Annotated[
        str | None,
        option(
            'FILE.py:NAME',
            'function that returns the features of a Gymnasium environment; also MODULE:NAME, an '
            'installed name, or observation',
        ),
    ] = None

    @property
    def domain_parameters(self) -> dict[str, Any]:
        """The parameters of the domain."""
        features = {} if self.features is None else {'features': self.features}
        return dict(self.parameter) | features


@dataclass(frozen=True, kw_only=True)
class LaunchOptions(DomainOptions):
    """Options common to all launches, one per field."""

    out: Annotated[
        Path | None,
        option(
            'DIR', 'folder for bags, options and logs; default: runs/DOMAIN, or a new one for demo'
        ),
    ] = None
    seed: Annotated[int, option('N', 'seed of every random draw', whole(0))] = 1
    strategy: Annotated[
        Literal['random', 'coverage', 'failures'], typer.Option(help='choice of start states')
    ] = STRATEGY
    learn: Annotated[
        Literal['trees', 'forest', 'goal'],
        typer.Option(
            '--learn',
            '--model',
            help='learning method: trees learns policies from the actions shown; forest '
            'does so with many trees, for precise ends; goal plans a path to an end '
            'like those shown, if all states can be listed',
        ),
    ] = METHOD
    derive: Annotated[
        list[str],
        option(
            'FORMULA',
            'also ask about a derived feature, such as "taxi_row - passenger_row"; may '
            'be repeated',
        ),
    ] = field(default_factory=list)
    budget: Annotated[
        int,
        option('N', 'maximum number of start states shown per option', whole(1)),
    ] = BUDGET
    unstick: Annotated[
        bool,
        flag(
            ' /--no-unstick',
            'no random moves when an option repeats itself; by default, the option takes one to '
            'three, in worlds that are restored by replay',
        ),
    ] = True
    success: Annotated[
        float | None,
        option(
            'SHARE',
            'minimum share of starts from which an option must reach an end like a demonstrated '
            'one; default: 0.95. Stricter where every start is known, laxer where actions '
            'have several outcomes',
            share,
        ),
    ] = None
    return_share: Annotated[
        float | None,
        option(
            'SHARE',
            'maximum shortfall in the return of an option, as a share of the range from random '
            'actions to the demonstrations; default: 0.1',
            share,
        ),
    ] = None
    initiation_error: Annotated[
        float | None,
        option(
            'SHARE',
            'maximum held-out error of the initiation set of an option; default: 0.05',
            share,
        ),
    ] = None
    termination_error: Annotated[
        float | None,
        option(
            'SHARE',
            'maximum share of held-out demonstrations in which an option ends early, late or '
            'never; default: 0.1',
            share,
        ),
    ] = None
    exam: Annotated[
        int | None,
        option(
            'N',
            'number of runs that a person judges once an option meets its criteria; '
            'default: 5; 0: none',
            whole(0),
        ),
    ] = None
    namespace: Annotated[str, option('NAME', 'namespace of the nodes; begins with /')] = '/'
    record_topics: Annotated[
        list[str],
        typer.Option(
            '--record',
            metavar='PATTERN',
            help='also record matching topics, such as /odom or /camera/*; may be repeated',
        ),
    ] = field(default_factory=list)
    record_exclude: Annotated[
        list[str],
        option('PATTERN', 'do not record matching topics; may be repeated'),
    ] = field(default_factory=list)
    split_bytes: Annotated[
        int | None,
        option(
            'SIZE',
            'start a new bag file at this size, such as 500M; default: never',
            size,
        ),
    ] = None
    split_seconds: Annotated[
        float | None,
        option(
            'SECONDS',
            'start a new bag file after this time; default: never',
            number('a number of seconds up to 1000000', lambda value: 0 < value <= 10**6),
        ),
    ] = None
    step_period: Annotated[
        float | None,
        option(
            'SECONDS',
            'time between steps of the machine; default: 0.15 for teach, 0.02 for demo '
            'in a terminal, otherwise 0',
            seconds,
        ),
    ] = None
    diagnostics: Annotated[bool, flag('--diagnostics', 'publish /diagnostics, for ROS tools')] = (
        False
    )
    views: Annotated[bool, flag('--views', 'publish the game for RViz and Foxglove')] = False
    joy: Annotated[
        str,
        option(
            'FILE',
            'let a person also drive with a gamepad: the file that maps its buttons '
            'and axes, or the word default for an Xbox pad',
            lambda text: text if text in ('', 'default') else os.path.abspath(text),
            show_default=False,
        ),
    ] = ''


@dataclass(frozen=True)
class SegmentOptions:
    """Options of the commands that cut plays into segments, one per field."""

    event: Annotated[
        list[str],
        option(
            'FEATURE',
            'feature whose changes are events; may be repeated; default: those that change rarely',
        ),
    ] = field(default_factory=list)
    name: Annotated[
        list[str],
        option(
            'NUMBER=OPTION',
            'option demonstrated by segments of kind NUMBER; may be repeated. '
            'Consecutive segments with the same name become one demonstration; '
            'segments without a name are left out',
        ),
    ] = field(default_factory=list)
    out: Annotated[
        Path | None,
        option('DIR', 'folder of a lesson, to which the demonstrations are added'),
    ] = None
    participant: Annotated[
        str, option('CODE', 'code of the person that the options belong to')
    ] = 'p1'


def with_options(command: Callable[..., int]) -> Callable[..., int]:
    """Turn each field of a command's dataclass arguments into an option."""

    def run(**values: Any) -> int:
        return command(**bundled(command, values))

    signature = inspect.signature(command)
    parameters: list[inspect.Parameter] = []
    for parameter in signature.parameters.values():
        kind = parameter.annotation
        parameters += [
            inspect.Parameter(
                each.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=[] if each.default is MISSING else each.default,
                annotation=each.type,
            )
            for each in (fields(kind) if is_dataclass(kind) else ())
        ] or [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)]
    run.__name__, run.__doc__ = command.__name__, command.__doc__
    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return run


def bundled(command: Callable[..., Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return the arguments of a command.

    :param values: option values by name; the fields of a dataclass are combined into one argument.
    """
    found = {}
    for name, parameter in inspect.signature(command).parameters.items():
        kind: Any = parameter.annotation
        options = fields(kind) if is_dataclass(kind) else None
        found[name] = (
            kind(**{each.name: values[each.name] for each in options}) if options else values[name]
        )
    return found


class CommandGroup(TyperGroup):
    """A command group that lists its commands if a command is unknown."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command named by the first word."""
        if not args[0].startswith('-') and args[0] not in self.commands:
            ctx.fail(f'unknown command {args[0]!r}; choose from {", ".join(self.commands)}')
        return super().resolve_command(ctx, args)


class SeveralValues(TyperCommand):
    """A command with list options that take all words up to the next option: ``--bags A B``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert the option before each of its values."""
        several = {name for option in self.params if option.multiple for name in option.opts}
        words: list[str] = []
        current = ''
        for word in args:
            if word.startswith('-'):
                current = word if word in several else ''
            elif current and words[-1] != current:
                words.append(current)
            words.append(word)
        return super().parse_args(ctx, words)
