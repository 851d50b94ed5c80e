# Source this file with $root set: it sets the variables of install/setup.bash in a millisecond, and
# unsets those of another ROS or Python.
unset $(< "$root/src/humanopts_ros/humanopts_ros/foreign_variables.txt")
# In addition to our packages: those of make robots, and those built into HUMANOPTS_OVERLAY.
for prefix in "$root"/install/humanopts_* "$root"/build/robots/*/ \
  ${HUMANOPTS_OVERLAY:+"$HUMANOPTS_OVERLAY"/*/}; do
  prefix=${prefix%/}
  [ -d "$prefix" ] || continue
  AMENT_PREFIX_PATH="$prefix${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}"
  LD_LIBRARY_PATH="$prefix/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}"
  for site in "$prefix"/lib/python3.*/site-packages; do
    PYTHONPATH="$site${PYTHONPATH:+:$PYTHONPATH}"
  done
done
export PYTHONPATH LD_LIBRARY_PATH AMENT_PREFIX_PATH="$AMENT_PREFIX_PATH:$root/.venv"
export PATH="$root/.venv/bin:$PATH"
export ROS_DISTRO=jazzy ROS_VERSION=2 ROS_PYTHON_VERSION=3
# Graphs stay on this machine unless the user changes the range.
export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
