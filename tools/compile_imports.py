"""
Import all modules that src/ imports, also inside functions, so that Python compiles them.

They are a hundredth of the installed modules; compiling all would take five times as long. This is
part of the set-up because other users may lack write permission. The modules of src/ are compiled
when they are installed.
"""

import ast
from contextlib import suppress
from importlib import import_module
from pathlib import Path


def main(source: Path) -> None:
    """Import the modules; optional packages may be missing."""
    needed = set[str]()
    for path in source.glob('humanopts_*/humanopts_*/**/*.py'):
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.ImportFrom) and node.module:
                needed.add(node.module)
            elif isinstance(node, ast.Import):
                needed |= {alias.name for alias in node.names}
    for name in sorted(needed):
        if not name.startswith('humanopts_'):
            with suppress(ImportError):
                import_module(name)


if __name__ == '__main__':
    main(Path('src'))
