"""Environment variables that humanopts processes share."""

LAUNCHER_PID = 'HUMANOPTS_LAUNCHER_PID'  # of the process that started a node; it ends with it
