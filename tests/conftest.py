"""What holds for all tests."""

import signal
import threading

# A shell that starts the suite in the background has it ignore Ctrl-C (nohup: the end of the terminal), and so would every
# program that a test starts.
if threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
