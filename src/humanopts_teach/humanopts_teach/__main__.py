"""``python -m humanopts_teach``: what is forked from this process does not import it again."""

import gc
import sys

from humanopts_teach.cli import main

if __name__ == '__main__':
    ended_with = main()
    gc.freeze()  # so that nothing is searched for garbage at the end: half a second after a demo
    sys.exit(ended_with)
