"""The command line ``scopt``.

A command is a function of the module named below; its parameters are its options.  A new option is one more parameter
there, with its help text, and is used in the body of the same function.  Options that several commands share are fields
of ``options.CloudOptions`` and ``options.ServerOptions``.  A new command is a function with the decorator
``command.command``, registered in ``app``.

| command | module |
| --- | --- |
| plan, verify, view, robots | ``plan`` |
| stance | ``stance`` |
| bench | ``bench`` |
| scene, detect | ``scene`` |
| serve, token, health | ``server`` |
| request, review, top: clients of a server, on ``connect`` | ``request``, ``review``, ``top`` |

``run`` turns errors into exit codes, ``report`` prints results.
"""

import sys


def main() -> None:
    """Entry point of the ``scopt`` program, which also takes a Ctrl-C while its modules are imported."""
    try:
        from service.cli.app import main as run_command
    except KeyboardInterrupt:
        print("cancelled", file=sys.stderr)
        raise SystemExit(130) from None
    except ImportError as error:
        from service.cli.foreign import explain_foreign_libraries

        if (cause := explain_foreign_libraries(error)) is None:
            raise
        print(cause, file=sys.stderr)
        raise SystemExit(70) from None
    run_command()
