"""The common parts of all humanopts nodes, independent of games and options."""

from humanopts_ros.middleware import set_aside_absent

set_aside_absent()
