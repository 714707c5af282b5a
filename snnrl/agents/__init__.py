"""Other agents in the robot's world: baselines, and environments for reinforcement-learning libraries."""
