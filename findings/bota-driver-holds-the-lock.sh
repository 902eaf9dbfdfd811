#!/usr/bin/env bash
# bota-driver 1.1.16: read_frame_blocking keeps Python's interpreter lock while it waits for a frame, so that every other thread
# of the process stands still until one comes: 100 ms at a time with the package's own dummy sensor, whose frames come ten
# times a second. A thread that only sleeps for a millisecond shows it.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check bota-driver==1.1.16
"$work/venv/bin/python" - <<'PYTHON' | grep -v 'bota\|^$'
import os
import sys
import threading
import time
import bota_driver

config = bota_driver.BotaDriverConfig()
config.communication_interface_name = "Bota_Dummy"
config.product_name, config.serial_number = "SensONE", "1"
config.dummy_communication_interface_params = bota_driver.BotaDummyCommunicationInterfaceConfig()
operation = bota_driver.GenASensorOperationConfig()
operation.app_mode = operation.app_submode = 0
config.genA_sensor_operation_params = operation
driver = bota_driver.BotaDriver(config)
assert driver.configure() and driver.activate()
for _ in range(8):  # what had piled up
    driver.read_frame_blocking()
gaps, done = [], threading.Event()


def beat():
    last = time.monotonic()
    while not done.is_set():
        time.sleep(0.001)
        gaps.append(time.monotonic() - last)
        last = time.monotonic()


thread = threading.Thread(target=beat)
thread.start()
begun = time.monotonic()
for _ in range(20):
    driver.read_frame_blocking()
seconds = time.monotonic() - begun
done.set()
thread.join()
gaps.sort()
print(f"20 frames in {seconds:.2f} s; a thread that sleeps 1 ms ran {len(gaps)} times, half of its pauses took {gaps[len(gaps) // 2] * 1e3:.0f} ms or more")
sys.stdout.flush()
driver.shutdown()
sys.stdout.flush()
os._exit(not (gaps[len(gaps) // 2] > 0.05))
PYTHON
