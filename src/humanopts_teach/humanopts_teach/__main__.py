"""``python -m humanopts_teach``: an entry point whose forked processes need no imports."""

import gc
import sys

from humanopts_teach.cli import main

if __name__ == '__main__':
    ended_with = main()
    gc.freeze()  # skip the final garbage collection: saves half a second after a demo
    sys.exit(ended_with)
