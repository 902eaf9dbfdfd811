"""What holds for all tests."""

import signal
import threading

from hypothesis import HealthCheck, settings

# How long an example takes on a busy machine says nothing of the code; a test that hangs has the suite's own limit.
settings.register_profile("any-machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any-machine")

# A shell that starts the suite in the background has it ignore Ctrl-C (nohup: the end of the terminal), and so would every
# program that a test starts.
if threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
