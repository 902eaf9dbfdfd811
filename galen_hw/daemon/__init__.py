"""The daemon: a small supervised process tree that drives devices and services and owns the bus.

`core` owns the force/torque sensor's wire, the compensation and the bus, so that raw to compensated is one function
call and one send. Other processes (motors with calibration, tracker with deflection, recorder) push their publications
to it. The supervisor answers commands, feeds systemd's watchdog and starts again what dies. See docs/adr/0010.
"""
