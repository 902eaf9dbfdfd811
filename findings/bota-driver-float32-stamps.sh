#!/usr/bin/env bash
# bota-driver 1.1.16: a frame's time stamp is an integer of microseconds that has been through a float32. After 17 s of the
# driver's clock it is rounded to 2 us, after 36 minutes to 256 us, though a frame that is made by hand keeps every digit:
# steps between samples at 1 kHz are wrong by up to a quarter. The package's own dummy sensor shows it.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check bota-driver==1.1.16 numpy==2.2.6
"$work/venv/bin/python" - <<'PYTHON' | grep -v 'bota\|^$'
import os
import sys
import bota_driver
import numpy as np

config = bota_driver.BotaDriverConfig()
config.communication_interface_name = "Bota_Dummy"
config.product_name, config.serial_number = "SensONE", "1"
config.dummy_communication_interface_params = bota_driver.BotaDummyCommunicationInterfaceConfig()
operation = bota_driver.GenASensorOperationConfig()
operation.app_mode = operation.app_submode = 0
operation.wrench_offset = bota_driver.WrenchOffset()
operation.temperature_coefficients = bota_driver.TemperatureCoefficients()
config.genA_sensor_operation_params = operation
driver = bota_driver.BotaDriver(config)
assert driver.configure() and driver.activate()
frame = driver.read_frame_blocking()
while frame.timestamp < 2**25:  # the first 34 s of the clock, where two microseconds would show little
    frame = driver.read_frame_blocking()
stamps = [driver.read_frame_blocking().timestamp for _ in range(30)]
made = bota_driver.BotaFrame(frame.status, [0.0] * 3, [0.0] * 3, 123456789, 25.0, [0.0] * 3, [0.0] * 3).timestamp
rounded = all(int(np.float32(stamp)) == stamp for stamp in stamps)
spacing = int(np.spacing(np.float32(stamps[-1])))
print(f"30 stamps, us: {stamps[:4]} ...; all of them multiples of {spacing} us: {rounded}; a frame made by hand: {made}", flush=True)
driver.shutdown()
sys.stdout.flush()
os._exit(not (rounded and made == 123456789))
PYTHON
