# Sourced with $root set: what install/setup.bash would set, in a millisecond.
for prefix in "$root"/install/humanopts_*; do
  AMENT_PREFIX_PATH="$prefix${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}"
  for site in "$prefix"/lib/python3.*/site-packages; do
    PYTHONPATH="$site${PYTHONPATH:+:$PYTHONPATH}"
  done
done
export PYTHONPATH AMENT_PREFIX_PATH="$AMENT_PREFIX_PATH:$root/.venv"
export LD_LIBRARY_PATH="$root/install/humanopts_interfaces/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}"
export PATH="$root/.venv/bin:$PATH"
# Another ROS installation's bootstrap must not keep ours from finding its libraries.
unset _ROS_WHEELS_BOOTSTRAP_COMPLETE
# Graphs stay on this machine unless the user says otherwise.
export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
