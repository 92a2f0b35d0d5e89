"""Entry point of ``python -m firmware_sim``: a simulated hand, drives without a hand, or the hub of a bus."""

import sys

from firmware_sim.command_line import check_words
from firmware_sim.description.hand_description import SimulatorError
from firmware_sim.printing import one_line_message

EXTRA_PACKAGES = ("mujoco",)
"""Import names of the packages that the command ``pip install handctl[sim]`` installs in addition."""


def main(words: list[str]) -> int:
    """Run one of the three programs: a simulated hand, simulated drives, or the hub of a bus.

    Args:
        words: command-line arguments without the name of the program.

    Returns:
        Exit code: 0 after SIGTERM or SIGINT, and 2 if the program cannot use the arguments or
        MuJoCo is missing.
    """
    try:  # The import is inside the function, because the hub of a bus needs neither MuJoCo nor a compiler.
        check_words(words)
        if words[:1] == ["bus"]:
            from firmware_sim.programs import bus as alone

            alone.run(words[1:])
        elif words[:1] == ["drive"]:
            from firmware_sim.programs import drive as bench

            bench.run(words[1:])
        else:
            from firmware_sim.programs import hand as simulate

            simulate.run(words)
    except ModuleNotFoundError as error:
        if error.name not in EXTRA_PACKAGES:
            raise
        print(
            f"firmware_sim: a simulated hand needs {error.name}: pip install 'handctl[sim]'",
            file=sys.stderr,
        )
        return 2
    except SimulatorError as error:
        print(f"firmware_sim: {one_line_message(str(error))}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
