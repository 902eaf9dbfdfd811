"""Where simulation and recording differ, what physics was left out, and whether the fit is better on data not learnt from."""
