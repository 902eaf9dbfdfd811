#!/usr/bin/env bash
# xacrodoc 2.0.1: a relative <xacro:include> is looked for in the working directory, whatever folder the including file is in;
# xacro itself looks beside the including file. From any other directory a robot in parts cannot be read, or other parts are
# taken that happen to lie there. The text is given on without the file's name. An include inside an included file is right.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check xacrodoc==2.0.1 xacro==2.1.1
mkdir "$work/robot"
cd "$work"
head='<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="arm">'
echo "$head<link name=\"of_the_robot\"/></robot>" > robot/part.xacro
echo "$head<xacro:include filename=\"part.xacro\"/></robot>" > robot/arm.urdf.xacro
links() { grep -o 'link name="[^"]*"' || echo nothing; }
own=$(venv/bin/xacro robot/arm.urdf.xacro | links)
elsewhere=$(venv/bin/xacrodoc robot/arm.urdf.xacro 2> said | links || true)
inside=$(cd robot && ../venv/bin/xacrodoc arm.urdf.xacro | links)
echo "$head<link name=\"of_the_working_directory\"/></robot>" > part.xacro
other=$(venv/bin/xacrodoc robot/arm.urdf.xacro | links)
echo "xacro:                                 $own"
echo "xacrodoc, from the folder above:       $elsewhere; $(tail -1 said)"
echo "xacrodoc, in the robot's folder:       $inside"
echo "xacrodoc, another part.xacro at hand:  $other"
[[ $own == *of_the_robot* && $elsewhere == nothing && $inside == "$own" && $other == *of_the_working_directory* ]]
