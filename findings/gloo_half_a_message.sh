#!/usr/bin/env bash
# gloo: a receive whose sender is killed in the middle of the message is never told of it.
#
# gloo reports a lost connection to every posted receive within milliseconds, but not to the one whose
# bytes it is reading at that moment: that waits for its whole timeout, half an hour by default, and
# says "Timed out". So a killed peer looks like a slow one, and more often the longer messages are. A
# receive of one byte that follows each message on the same connection, and is waited for in its
# place, is told at once. torch 2.13.0 (cpu).
# Seen on 2026-11-29: "bytes received of 400,000,000: 9,989,263", "the next receive: error after 0.0 s: Connection closed
# by peer", "the receive half done: error after 5.0 s: Timed out waiting 5000ms for recv operation to complete".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet torch==2.13.0 numpy
cd "$folder"
OMP_NUM_THREADS=1 "$folder/venv/bin/python" - <<'PYTHON'
import os
import signal
import sys
import time
from datetime import timedelta

import torch
from torch.distributed import FileStore, ProcessGroupGloo

NUM_BYTES = 400_000_000
child = os.fork()
options = ProcessGroupGloo._Options()
options._devices = [ProcessGroupGloo.create_device(hostname="127.0.0.1")]
group = ProcessGroupGloo(FileStore("store", -1), 0 if child else 1, 2, options)
if not child:
    group.send([torch.ones(NUM_BYTES, dtype=torch.uint8)], 0, 0).wait()
    time.sleep(60)
data, byte = torch.zeros(NUM_BYTES, dtype=torch.uint8), torch.zeros(1, dtype=torch.uint8)
half, following = group.recv([data], 1, 0), group.recv([byte], 1, 1)
while not data[1000]:
    time.sleep(0.001)
os.kill(child, signal.SIGSTOP)  # so that it is killed in the middle
time.sleep(0.5)
received = int(data.count_nonzero())
print(f"bytes received of {NUM_BYTES:,}: {received:,}")
os.kill(child, signal.SIGKILL)
waited = []
for name, work in (("the next receive", following), ("the receive half done", half)):
    start = time.monotonic()
    try:
        work.wait(timedelta(seconds=5))
        says = "no error"
    except RuntimeError as error:
        says = f"error after {time.monotonic() - start:.1f} s: {str(error).split('] ', 1)[-1].split(' [')[0]}"
    waited.append(time.monotonic() - start)
    print(f"{name}: {says}")
sys.exit(0 if 0 < received < NUM_BYTES and waited[0] < 1 and waited[1] > 4 else 1)
PYTHON
