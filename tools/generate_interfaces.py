"""
generate_interfaces.py FOLDER: run the generators of ROS interfaces that CMake configured there.

make would run one after another, and each would parse all interfaces again. Here the interfaces
are parsed once, without comments, and the generators run in parallel. make then finds everything
up to date.
"""

from concurrent.futures import ProcessPoolExecutor
import functools
import multiprocessing
from pathlib import Path
import re
import runpy
import sys

from rosidl_parser import parser

TYPE_SUPPORTS = ['rosidl_typesupport_fastrtps_c', 'rosidl_typesupport_introspection_c']
DISPATCH = 'rosidl_typesupport_c'
FIRST = 'rosidl_generator_type_description'  # the others read its output
OTHERS = {  # the slowest first
    'rosidl_generator_py': ['--typesupport-impls', ';'.join((*TYPE_SUPPORTS, DISPATCH))],
    'rosidl_generator_c': [],
    'rosidl_typesupport_fastrtps_c': [],
    'rosidl_typesupport_introspection_c': [],
    DISPATCH: ['--typesupports', *TYPE_SUPPORTS],
}
# Comments are two thirds of the text, and Python does not need them.
COMMENT = re.compile(r'@verbatim \(language="comment", text=\n(?: *".*\n)+')
LIBRARIES = Path(sys.prefix) / 'lib'


def generate(folder: Path, name: str, *arguments: str) -> None:
    """Run one generator, as make would."""
    described = str(folder / f'{name}__arguments.json')
    sys.argv = [name, '--generator-arguments-file', described, *arguments]
    try:
        runpy.run_path(str(LIBRARIES / name / name), run_name='__main__')
    except SystemExit as end:
        if end.code:
            raise


def main(folder: Path) -> None:
    """Run all generators; refuse unknown ones, since their output would be missing."""
    described = folder.glob('rosidl_*__arguments.json')
    names = {path.name.removesuffix('__arguments.json') for path in described}
    if names - {'rosidl_adapter'} != {FIRST, *OTHERS}:
        sys.exit(f'{__file__} knows {FIRST}, {", ".join(OTHERS)}; found are {", ".join(names)}')
    parse = parser.parse_idl_string

    @functools.cache
    def parse_once(text: str, png_file: None = None) -> object:
        return parse(COMMENT.sub('', text), png_file=png_file)

    parser.parse_idl_string = parse_once
    generate(folder, FIRST)
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context('fork')) as pool:
        for each in [pool.submit(generate, folder, name, *args) for name, args in OTHERS.items()]:
            each.result()


if __name__ == '__main__':
    main(Path(sys.argv[1]))
