"""A client of the virtual robot's CAN wire: python-can alone, no driver of this project."""

import time

import can


def open_bus(robot):
    return can.Bus(**robot.addresses["can0"], sleep_after_open=0)


def ask(bus, identifier, data=b"", replies=1):
    bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
    out, deadline = [], time.monotonic() + 2.0
    while len(out) < replies and time.monotonic() < deadline:
        message = bus.recv(0.2)
        if message is not None:
            out.append((message.arbitration_id, bytes(message.data)))
    return out
