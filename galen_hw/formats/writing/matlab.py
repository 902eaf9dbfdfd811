"""A recording as a MATLAB file: the table `recording` with our column names, and `info`, the text of recording.json.

In MATLAB: `load run.mat; plot(recording.time, recording.("wrench.force.x"))`. Every digit is kept.
"""

import warnings
from pathlib import Path

from galen_hw.formats.contents import needed
from galen_hw.recording import Recording


def write(recording: Recording, path: Path) -> list[str]:
    """Write it.

    Raises:
        UsageError: mat-io is not installed.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it sets an option of pandas that is the default by now
            import pandas as pd
            from matio import save_to_mat
    except ImportError as error:
        raise needed("mat-io", "a MATLAB file")(error) from None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        held = {"recording": pd.DataFrame(recording.columns), "info": recording.info.to_json()}
        if text := recording.urdf_text:
            held["robot_description"] = text
        save_to_mat(str(path), held)
    return []
