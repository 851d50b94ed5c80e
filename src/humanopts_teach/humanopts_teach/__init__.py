"""Teaching dialogue, teleoperation, recording, bag analysis, the launcher and the command line."""
