"""A first OBC: run `st-emulator run roja1` in one terminal and this in another."""

from st_emulator.obc import Obc

with Obc.connect("pty") as obc:
    print(f"ping: {obc.ping() * 1e3:.1f} ms")
    obc.set_time()  # the computer's time
    obc.acquire()  # completes with the first valid attitude
    for _ in range(8):
        report = obc.next("attitude_report").fields
        print(report["frame_index"], report["valid"], report["stars_identified"], report["q_w"])
