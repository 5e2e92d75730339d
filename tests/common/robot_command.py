"""`repose robot` as an operator has it, for tests in Python: in a module that the folders of several of them import."""

import subprocess
import time


def robot_command(program, endpoint, action):
    """`repose robot ACTION`, which has to come true, but for a retreat: there may be no room for it.

    Again where it is refused, for on a busy machine a state or a scene may come late.
    """
    ends = time.monotonic() + 60
    while True:
        command = [program, "robot", action, "--connect", endpoint]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        if done.returncode == 0 or action == "retreat":
            return
        # What came of an action is printed, whatever it was; a refusal is not, and nothing has moved.
        assert not done.stdout and time.monotonic() < ends, f"{action}: {done.stdout}{done.stderr}"
        time.sleep(0.2)
