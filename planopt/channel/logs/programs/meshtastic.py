"""Meshtastic range tests: rangetest.csv of the receiving node."""

from planopt.channel.logs.readers import LogReader

MOVING = (
    "positions are those of the receiver; if the sender moved, give --columns "
    'x="sender long",y="sender lat"'
)

SNR_WORDS = (
    "rx snr is a signal-to-noise ratio in dB, not a power: thresholds are SNR too, and strong "
    "signals saturate near 10 dB"
)


def _reader(power: str, words: str, remark: str) -> LogReader:
    return LogReader(
        summary=f"Meshtastic range test, rangetest.csv {words}",
        signature=("sender name", "sender lat", "sender long", "rx lat", "rx long", power),
        x="rx long",
        y="rx lat",
        power=power,
        transmitter="from",
        remark=remark,
    )


SNR = _reader("rx snr", "with the SNR", f"{SNR_WORDS}; {MOVING}")
RSSI = _reader("rx rssi", "with the RSSI", MOVING)
