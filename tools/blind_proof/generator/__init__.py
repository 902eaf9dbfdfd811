"""Recordings with concealed effects: multibody physics in MuJoCo, sensors, time and temperature written anew.

Shares no code and no formula with the tool that is judged; import-linter forbids it both ways.
"""
