"""What the commands do; their options are in ``humanopts_teach.cli``."""
