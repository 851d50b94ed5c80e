"""Starting and stopping the processes of a graph."""

MODULES = {  # modules of the nodes, in start order
    'recorder': 'humanopts_teach.ros.recorder',
    'game': 'humanopts_env.ros.game_node',
    'world': 'humanopts_env.ros.world_node',
    'learner': 'humanopts_learner.ros.learner_node',
    'lesson': 'humanopts_teach.ros.lesson_node',
    'option_server': 'humanopts_learner.ros.option_server',
    'planner': 'humanopts_learner.ros.planner_node',
    'diagnostics': 'humanopts_teach.ros.diagnostics',
    'views': 'humanopts_teach.ros.views',
    'joy_teleop': 'humanopts_teach.ros.joy_teleop',
    'simulated_teacher': 'humanopts_teach.ros.simulated_teacher',
    'keyboard_teleop': 'humanopts_teach.ros.keyboard_teleop',
}
RECORDER, CONDUCTOR = 'recorder', 'conductor'  # the latter runs in the launcher's own process
OUTLASTING = 20.0  # s that a recorder waits for other nodes of its launch to end
USUAL = 'recorder', 'game', 'learner', 'lesson', 'option_server', 'planner'  # nodes of a launch


class LaunchError(RuntimeError):
    """The graph cannot start, or one of its nodes died; the text gives the node and the reason."""


class OccupiedError(LaunchError):
    """Another launch already runs a node or uses the folder of this one; the text names both."""
