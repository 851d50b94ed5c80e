"""
generate_interfaces.py FOLDER: runs the generators of ROS interfaces that CMake configured there.

make would run one after the other, and each would parse all interfaces again, which is most of
their work. Here they are parsed once, and all cores generate. make finds everything up to date.
"""

from concurrent.futures import ProcessPoolExecutor
import functools
import multiprocessing
from pathlib import Path
import runpy
import sys

from rosidl_parser import parser

TYPE_SUPPORTS = ['rosidl_typesupport_fastrtps_c', 'rosidl_typesupport_introspection_c']
DISPATCH = 'rosidl_typesupport_c'
FIRST = 'rosidl_generator_type_description'  # the others read what it writes
OTHERS = {  # the longest first
    'rosidl_generator_py': ['--typesupport-impls', ';'.join((*TYPE_SUPPORTS, DISPATCH))],
    'rosidl_generator_c': [],
    'rosidl_typesupport_fastrtps_c': [],
    'rosidl_typesupport_introspection_c': [],
    DISPATCH: ['--typesupports', *TYPE_SUPPORTS],
}
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
    """Run them all; one that is not known here would leave its part out of what others write."""
    described = folder.glob('rosidl_*__arguments.json')
    names = {path.name.removesuffix('__arguments.json') for path in described}
    if names - {'rosidl_adapter'} != {FIRST, *OTHERS}:
        sys.exit(f'{__file__} knows {FIRST}, {", ".join(OTHERS)}; found are {", ".join(names)}')
    parser.parse_idl_string = functools.cache(parser.parse_idl_string)
    generate(folder, FIRST)
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context('fork')) as pool:
        for each in [pool.submit(generate, folder, name, *args) for name, args in OTHERS.items()]:
            each.result()


if __name__ == '__main__':
    main(Path(sys.argv[1]))
