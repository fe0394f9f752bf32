"""Contact forces of the body: those of one configuration, poses that they hold, and where they hold it under loads."""
