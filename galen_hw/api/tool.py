"""`load_tool`: a tool's file, from the store of this machine or from a path."""

from pathlib import Path

from galen_hw.config.tool_file import ToolFile
from galen_hw.errors import UsageError

Tool = ToolFile | Path | str
"""A tool's file, its path, or the name of a tool of this machine's store."""


def load_tool(tool: Tool, *, state: Path | str | None = None) -> ToolFile:
    """Read a tool: mass (kg), centre of mass (m, sensor frame), bias, covariance, further terms, and where they came from.

    Args:
        tool: a name (`galen-hw tool list`), or the path of a tool's file, which ends in `.json`.
        state: state directory that holds the store; that of the running daemon, else the user's own, if None.

    Raises:
        UsageError: no such tool or file, or it is damaged.
    """
    if isinstance(tool, ToolFile):
        return tool
    path = Path(tool)
    if path.suffix != ".json" and not path.is_file():
        from galen_hw.config.tool_store import ToolStore
        from galen_hw.tools.tool import tool_store

        return (tool_store(None) if state is None else ToolStore(Path(state))).load(str(tool))
    from galen_hw.config.tool_file import parse_tool

    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"cannot be read ({error})", where=str(path), todo="give a tool's file or name") from None
    return parse_tool(text, str(path))
