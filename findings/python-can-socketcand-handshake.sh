#!/bin/sh
# python-can 4.6.1, interface "socketcand": the handshake takes what one recv() returns for one whole answer.
#
# TCP is a stream. A socketcand server whose bus is busy sends the first frame right behind the answer to "< rawmode >",
# and the kernel hands both over in one recv(): _expect_msg() then compares "< ok >< frame 001 ... >" with "< ok >",
# and the bus cannot be opened. Whether it happens is a matter of microseconds, so that a busy bus opens now and then.
# The same when a slow network cuts "< ok >" in two.
#
# Seen: "Expected '< ok >' got: '< ok >< frame ...'". Exit status 0 while that is so, 1 when it behaves otherwise.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check python-can==4.6.1
"$folder/venv/bin/python" - <<'EOF'
import socket
import sys
import threading

import can


def opens(*answers):
    """What comes of opening a server that gives these answers, each in the given pieces."""
    server = socket.create_server(("127.0.0.1", 0))

    def serve():
        connection, _ = server.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for number, answer in enumerate(answers):
            if number:
                connection.recv(100)
            connection.sendall(answer)
        connection.recv(100)
        connection.close()

    threading.Thread(target=serve, daemon=True).start()
    try:
        can.Bus("can0", "socketcand", ignore_config=True, host="127.0.0.1", port=server.getsockname()[1]).shutdown()
    except can.CanError as error:
        return str(error)
    return "opened"


quiet = opens(b"< hi >", b"< ok >", b"< ok >")
busy = opens(b"< hi >", b"< ok >", b"< ok >< frame 001 1.000000 0A0B >")
print("python-can", can.__version__)
print("  a quiet bus:", quiet)
print("  a busy bus: ", busy)
sys.exit(not (quiet == "opened" and busy.startswith("Expected '< ok >' got: '< ok >< frame 001")))
EOF
