"""Ground floor: geometry, kinematics, measurements, drives, trajectories, evaluation."""
