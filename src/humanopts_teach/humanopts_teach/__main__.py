"""``python -m humanopts_teach``: entry point; forked processes do not import it again."""

import gc
import sys

from humanopts_teach.cli import main

if __name__ == '__main__':
    ended_with = main()
    gc.freeze()  # skip the final garbage collection: saves half a second after a demo
    sys.exit(ended_with)
