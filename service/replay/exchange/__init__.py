"""Exchange with other planners and programs: their trajectories certified, our results exported.

``joint_trajectory`` is a trajectory of points; ``text_files`` and ``bag_files`` read it, ``read`` chooses between them;
``interpolation`` makes a curve of it; ``certify`` proves or refutes it.  ``ros_types`` has the types of ROS messages.
"""
