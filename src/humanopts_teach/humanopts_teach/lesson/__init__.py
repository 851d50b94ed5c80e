"""A teaching session: what is asked, kept and shown, as pure values and rules, without ROS."""
