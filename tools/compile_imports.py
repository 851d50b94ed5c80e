"""
Import every module of src/ and all imports inside functions, so that Python compiles them.

These are a hundredth of the installed modules; compiling all takes five times as long. This is
part of the set-up because other users may lack write permission.
"""

import ast
from contextlib import suppress
from importlib import import_module
from pathlib import Path


def main(source: Path) -> None:
    """Import all modules; optional packages may be missing."""
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
