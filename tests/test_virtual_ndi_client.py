"""NDI's own client library drives the virtual tracker over a pty, in another process."""

import json

import numpy as np
import pytest

from galen_hw.drivers.virtual.ndi_tracker import VirtualNdiTracker
from galen_hw.drivers.virtual.ndi_tracker.scene import REFERENCE, TOOL
from galen_hw.drivers.virtual.world import World
from galen_hw.spatial import quaternion_from_rotation
from tests.pty_peer import rom, run_client

pytest.importorskip("ndicapy")
pytest.importorskip("sksurgerynditracker")

NDICAPI = """
import json, sys
import ndicapy as ndi
name, rom = sys.argv[1:3]
# The library waits a tenth of a second for the answer to its break: a busy machine may need longer, so ask again.
out = {"probe": next((0 for _ in range(5) if ndi.ndiProbe(name) == 0), "no answer")}
device = ndi.ndiOpen(name)
out["init"] = ndi.ndiCommand(device, "INIT:")
out["comm"] = ndi.ndiCommand(device, "COMM:50000")
out["version"] = ndi.ndiVER(device, 0)
out["handles"] = []
for _ in range(2):
    ndi.ndiCommand(device, "PHRQ:*********1****")
    handle = ndi.ndiGetPHRQHandle(device)
    assert ndi.ndiPVWRFromFile(device, handle, rom) == 0, ndi.ndiGetError(device)
    out["handles"].append(handle)
ndi.ndiCommand(device, "PHSR:02")
out["uninitialised"] = ndi.ndiGetPHSRNumberOfHandles(device)
for handle in out["handles"]:
    ndi.ndiCommand(device, f"PINIT:{handle:02X}")
    ndi.ndiCommand(device, f"PENA:{handle:02X}D")
    assert ndi.ndiGetError(device) == 0
out["port"] = ndi.ndiCommand(device, "PHINF:010025")
ndi.ndiCommand(device, "TSTART:80")
for kind, transform, frame in (
    ("TX", ndi.ndiGetTXTransform, ndi.ndiGetTXFrame), ("BX", ndi.ndiGetBXTransform, ndi.ndiGetBXFrame)
):
    out[kind] = []
    last = -1
    while len(out[kind]) < 20:
        ndi.ndiCommand(device, kind + ":0801")
        assert ndi.ndiGetError(device) == 0, ndi.ndiErrorString(ndi.ndiGetError(device))
        handles = [bytes([h]) for h in out["handles"]]
        number = frame(device, handles[0])
        if number != last:
            out[kind].append([number, *[transform(device, h) for h in handles]])
            last = number
ndi.ndiCommand(device, "TSTOP:")
ndi.ndiCommand(device, "BEEP:1")
out["error"] = ndi.ndiGetError(device)
try:
    ndi.ndiCommand(device, "NONSENSE:")
except OSError as error:
    out["nonsense"] = str(error)
ndi.ndiClose(device)
print(json.dumps(out))
"""

SCIKIT = """
import json, sys
from sksurgerynditracker.nditracker import NDITracker
tracker = NDITracker({"tracker type": "polaris", "serial port": sys.argv[1], "romfiles": [sys.argv[2]] * 2})
tracker.use_quaternions = True
tracker.start_tracking()
frames = [[list(map(float, part)) if name == "quality" else [x.tolist() if hasattr(x, "tolist") else x for x in part]
           for name, part in zip(("ports", "times", "frames", "tracking", "quality"), tracker.get_frame(), strict=True)]
          for _ in range(30)]
tracker.stop_tracking()
tracker.close()
print(json.dumps(frames))
"""


def truth(device, marker):
    scene = device.session.scene
    pose = scene._pose(marker, 0)
    x, y, z, w = quaternion_from_rotation(pose[:3, :3])
    return np.array([w, x, y, z, *(1e3 * pose[:3, 3])])


def test_ndicapi_probes_initialises_tracks_and_reads_both_replies():
    """Probe, INIT, COMM to 115200, ROMs, PHSR, PINIT, PENA, PHINF, TSTART, TX and BX, TSTOP, and an error."""
    device = VirtualNdiTracker(VirtualNdiTracker.Settings(), World())
    out = json.loads(run_client(device, NDICAPI, str(rom())))

    assert out["probe"] == 0
    assert (out["init"], out["comm"]) == ("OKAY", "OKAY")
    assert "Freeze Tag: Polaris Spectra 010" in out["version"]
    assert (out["handles"], out["uninitialised"]) == ([1, 2], 2)
    assert (len(out["port"]), out["port"][31:33]) == (33 + 20 + 14, "31")
    assert (out["error"], out["nonsense"]) == (0, "POLARIS 0x01: Invalid command")
    for kind in ("TX", "BX"):
        numbers = [row[0] for row in out[kind]]
        assert numbers == sorted(set(numbers))
        for column, marker in ((1, TOOL), (2, REFERENCE)):
            got = np.array([row[column][:7] for row in out[kind]])
            np.testing.assert_allclose(got.mean(axis=0), truth(device, marker), atol=0.1)
            assert np.ptp(got[:, 4]) > 0.01


def test_scikit_surgery_tracks_two_tools():
    """The wrapper that most labs use connects, configures and reads frames whose poses are the markers'."""
    device = VirtualNdiTracker(VirtualNdiTracker.Settings(), World())
    frames = json.loads(run_client(device, SCIKIT, str(rom())))
    last = frames[-1]

    assert last[0] == [1, 2]
    assert frames[-1][2][0] > frames[0][2][0] >= 0
    for column, marker in ((0, TOOL), (1, REFERENCE)):
        np.testing.assert_allclose(np.ravel(last[3][column]), truth(device, marker), atol=0.5)
    assert all(0.0 < q < 0.2 for q in last[4])
