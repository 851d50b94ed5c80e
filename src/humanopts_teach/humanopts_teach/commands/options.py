"""The options that ``demo``, ``up`` and ``teach`` share, and how texts become their values."""

from collections.abc import Callable
from dataclasses import dataclass, Field, field, fields, is_dataclass, MISSING
import inspect
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
ExcelOption = Annotated[
    bool, typer.Option('--excel', help='begin CSV files with a byte order mark, as Excel needs')
]
_UNITS = {'': 1, 'k': 10**3, 'M': 10**6, 'G': 10**9}


def number(what: str, accepted: Callable[[Any], bool], kind: type = float) -> Callable[[str], Any]:
    """
    Return a parser of numbers.

    :param what: the numbers that are accepted, to complete "... is not"; NaN never is.
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
    """Return a parser of whole numbers from ``least`` to 2**31 - 1."""
    return number(f'from {least} to {2**31 - 1}', lambda value: least <= value < 2**31, int)


def size(text: str) -> int:
    """Return the bytes of a size such as 500M."""
    digits = text.rstrip('kMG')
    unit = _UNITS.get(text[len(digits) :])
    value = int(digits) * unit if unit and digits.isascii() and digits.isdigit() else 0
    if not 0 < value <= MAX_BYTES:
        raise typer.BadParameter(f'{text!r} is not a size such as 500M')
    return value


def name_and_value(text: str) -> tuple[str, Any]:
    """Return the name and the value of a domain's parameter, such as rows=7."""
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
    """Refuse a parameter that is given twice: one of its values would silently be lost."""
    names = [name for name, _ in pairs]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise typer.BadParameter(f'{", ".join(twice)} is given twice')
    return pairs


def several_games(count: int) -> int:
    """Check a number of games: 0, or as many as have an interval."""
    if count == 1:
        raise typer.BadParameter('one game has no interval; give 0, or 2 or more')
    return count


any_number = number('a number', lambda value: True)
share = number('from 0 to below 1', lambda value: 0 <= value < 1)
seconds = number('from 0 to 60', lambda value: 0 <= value <= 60)


OnlyOption = Annotated[
    str,
    typer.Option(
        metavar='NAMES',
        show_default=False,
        help='start only these nodes here, such as game,lesson,recorder, and the others on '
        'another machine; default: all',
    ),
]


def node_names(text: str) -> tuple[str, ...]:
    """Return the names in a text, where they are separated by commas."""
    return tuple(name.strip() for name in text.split(',') if name.strip())


def _threshold(parser: Callable[[str], Any], metavar: str, what: str) -> Any:
    """Return the option of a criterion's threshold."""
    text = f'of an option: {what}'
    return typer.Option(parser=parser, metavar=metavar, help=text)


@dataclass(frozen=True)
class PageOptions:
    """What the command line says about pages that are served; each field is an option."""

    browser: Annotated[
        bool, typer.Option('--browser', help='serve pages; several people can take part at once')
    ] = False
    host: Annotated[
        str, typer.Option(metavar='ADDRESS', help='with --browser: to serve at; 0.0.0.0: all')
    ] = '127.0.0.1'
    port: Annotated[
        int,
        typer.Option(min=0, max=65535, metavar='N', help='with --browser; 0: any that is free'),
    ] = 8080
    allow_host: Annotated[
        list[str],
        typer.Option(
            metavar='NAME',
            help='with --browser: a name of this machine in browsers, such as that of a reverse '
            'proxy; may be repeated',
        ),
    ] = field(default_factory=list)
    seats: Annotated[
        int | None,
        typer.Option(
            parser=whole(1),
            metavar='N',
            help='with --browser: games at once at most; further people wait in line; default: '
            'as many as fit into the memory',
        ),
    ] = None
    linger: Annotated[
        float,
        typer.Option(
            parser=number('from 1 to 86400', lambda value: 1 <= value <= 86400),
            metavar='SECONDS',
            help='with --browser: how long a game goes on whose page is closed',
        ),
    ] = 120.0


@dataclass(frozen=True)
class LaunchOptions:
    """What the command line says about a launch; each field is an option."""

    out: Annotated[
        Path | None,
        typer.Option(
            metavar='DIR',
            help='folder for bags, options and logs; default: runs/DOMAIN, and a new one for demo',
        ),
    ] = None
    seed: Annotated[
        int, typer.Option(parser=whole(0), metavar='N', help='of every random draw')
    ] = 1
    strategy: Annotated[
        Literal['random', 'coverage', 'failures'],
        typer.Option(help='how start states are chosen'),
    ] = STRATEGY
    learn: Annotated[
        Literal['trees', 'goal'],
        typer.Option(
            help='trees: policies are learned from the actions shown; goal: they are planned, to '
            'an end like those shown, where all states can be listed'
        ),
    ] = METHOD
    budget: Annotated[
        int,
        typer.Option(parser=whole(1), metavar='N', help='most start states shown for an option'),
    ] = BUDGET
    return_delta: Annotated[
        float | None,
        _threshold(
            any_number,
            'UNITS',
            'reward units by which its return may fall short; default: a tenth of the range from '
            'random actions to the demonstrations',
        ),
    ] = None
    initiation_error: Annotated[
        float | None,
        _threshold(share, 'SHARE', 'share that its held-out I may get wrong; default: 0.05'),
    ] = None
    termination_error: Annotated[
        float | None,
        _threshold(share, 'SHARE', 'share that its held-out β may get wrong; default: 0.05'),
    ] = None
    parameter: Annotated[
        list[Any],  # of pairs: a name and a value
        typer.Option(
            parser=name_and_value,
            callback=each_once,
            metavar='NAME=VALUE',
            help='a parameter of the domain, such as rows=7 or is_slippery=false; may be repeated',
        ),
    ] = field(default_factory=list)
    namespace: Annotated[str, typer.Option(metavar='NAME', help='of the nodes')] = '/'
    record: Annotated[
        list[str],
        typer.Option(
            metavar='PATTERN',
            help='also record topics like this, such as /odom or /camera/*; may be repeated',
        ),
    ] = field(default_factory=list)
    record_exclude: Annotated[
        list[str],
        typer.Option(metavar='PATTERN', help='do not record topics like this; may be repeated'),
    ] = field(default_factory=list)
    split_bytes: Annotated[
        int | None,
        typer.Option(
            parser=size,
            metavar='SIZE',
            help='go on in another file of the bag at this size, such as 500M; default: never',
        ),
    ] = None
    split_seconds: Annotated[
        float | None,
        typer.Option(
            parser=number('a number of seconds up to 1000000', lambda value: 0 < value <= 10**6),
            metavar='SECONDS',
            help='and after this time; default: never',
        ),
    ] = None
    step_period: Annotated[
        float | None,
        typer.Option(
            parser=seconds,
            metavar='SECONDS',
            help='between steps of the machine, to watch it; default: 0.15 for teach, '
            '0.02 for demo in a terminal, else 0',
        ),
    ] = None
    diagnostics: Annotated[
        bool,
        typer.Option('--diagnostics', help='publish /diagnostics, for the tools of ROS'),
    ] = False
    views: Annotated[
        bool,
        typer.Option('--views', help='publish the game for RViz and Foxglove'),
    ] = False


def with_options(command: Callable[..., int]) -> Callable[..., int]:
    """Give a command every field of its arguments that are dataclasses as an option."""
    signature = inspect.signature(command)
    given = {p.name: p.annotation for p in signature.parameters.values()}
    bundles = {name: fields(kind) for name, kind in given.items() if is_dataclass(kind)}

    def run(**values: Any) -> int:
        for name, options in bundles.items():
            values[name] = given[name](**{each.name: values.pop(each.name) for each in options})
        return command(**values)

    parameters: list[inspect.Parameter] = []
    for parameter in signature.parameters.values():
        options = bundles.get(parameter.name)
        parameters += [parameter] if options is None else map(_parameter, options)
    keyword = inspect.Parameter.KEYWORD_ONLY
    run.__name__, run.__doc__ = command.__name__, command.__doc__
    run.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[parameter.replace(kind=keyword) for parameter in parameters]
    )
    return run


def _parameter(option: 'Field[Any]') -> inspect.Parameter:
    default = [] if option.default is MISSING else option.default
    kind = inspect.Parameter.KEYWORD_ONLY
    return inspect.Parameter(option.name, kind, default=default, annotation=option.type)


class CommandGroup(TyperGroup):
    """Commands; unknown ones are refused with the names of those that there are."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that the first word names."""
        if not args[0].startswith('-') and args[0] not in self.commands:
            ctx.fail(f'unknown command {args[0]!r}; choose from {", ".join(self.commands)}')
        return super().resolve_command(ctx, args)


class SeveralValues(TyperCommand):
    """A command whose list options take every word up to the next option, as ``--bags A B``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Write the option before each of its words."""
        several = {name for option in self.params if option.multiple for name in option.opts}
        words: list[str] = []
        under_way = ''
        for word in args:
            if word.startswith('-'):
                under_way = word if word in several else ''
            elif under_way and words[-1] != under_way:
                words.append(under_way)
            words.append(word)
        return super().parse_args(ctx, words)
