"""
Imports every module of src/, and what their functions import, so that Python keeps it compiled.

A hundredth of what is installed is used; to compile all of it takes five times as long. It is done
when it is installed, as others who run it may have no right to write there.
"""

import ast
from contextlib import suppress
from importlib import import_module
from pathlib import Path


def main(source: Path) -> None:
    """Import them all; what is optional may be missing."""
    for path in sorted(source.glob('humanopts_*/humanopts_*/**/[!_]*.py')):
        needed = ['.'.join(path.relative_to(source).with_suffix('').parts[1:])]
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.ImportFrom) and node.module:
                needed.append(node.module)
            elif isinstance(node, ast.Import):
                needed += [alias.name for alias in node.names]
        for name in needed:
            with suppress(ImportError):
                import_module(name)


if __name__ == '__main__':
    main(Path('src'))
