"""What is raised for models that the engine leaves to MuJoCo."""


class Uncovered(Exception):  # no error: another simulator takes over
    """A model has what the engine does not simulate; the message says what and where."""
