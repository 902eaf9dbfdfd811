#!/usr/bin/env bash
# libzmq 4.3 (pyzmq 27.1.0): ZMQ_MAXMSGSIZE, which the manual calls a bound of inbound messages, is applied to the handshake of
# CURVE as well. A publisher that bounds its subscribers' wishes to 256 bytes refuses every peer, silently and again and again:
# the INITIATE command is about 280 bytes long. With 300 the same keys are accepted.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check pyzmq==27.1.0
"$work/venv/bin/python" - <<'PYTHON'
import sys
import zmq

context = zmq.Context()
server, client = zmq.curve_keypair(), zmq.curve_keypair()
heard = {}
for bound in (256, 300):
    publisher, subscriber = context.socket(zmq.XPUB), context.socket(zmq.SUB)
    publisher.setsockopt(zmq.MAXMSGSIZE, bound)
    publisher.curve_publickey, publisher.curve_secretkey = server
    publisher.curve_server = True
    port = publisher.bind_to_random_port("tcp://127.0.0.1")
    subscriber.curve_publickey, subscriber.curve_secretkey = client
    subscriber.curve_serverkey = server[0]
    subscriber.connect(f"tcp://127.0.0.1:{port}")
    subscriber.subscribe(b"a")
    heard[bound] = bool(publisher.poll(3000))
    print(f"bound of {bound} bytes: a subscription of 2 bytes {'arrives' if heard[bound] else 'never arrives'}")
    publisher.close(0)
    subscriber.close(0)
sys.exit(heard != {256: False, 300: True})
PYTHON
