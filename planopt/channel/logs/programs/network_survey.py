"""Network Survey (Android): one CSV for each technology."""

from planopt.channel.logs.readers import LogReader

COMMON = ("deviceTime", "latitude", "longitude", "missionId", "recordNumber")


def _reader(technology: str, own: tuple[str, ...], power: str, transmitter: str) -> LogReader:
    return LogReader(
        summary=f"Network Survey (Android), CSV of {technology}",
        signature=(*COMMON, *own, power, transmitter),
        x="longitude",
        y="latitude",
        power=power,
        transmitter=transmitter,
        time="deviceTime",
        accuracy="accuracy",
    )


GSM = _reader("GSM", ("arfcn", "bsic"), "signalStrength", "ci")
UMTS = _reader("UMTS", ("uarfcn", "psc"), "rscp", "cid")
LTE = _reader("LTE", ("earfcn", "pci"), "rsrp", "eci")
NR = _reader("5G NR", ("narfcn", "pci"), "ssRsrp", "nci")
WIFI = _reader("Wi-Fi", ("ssid", "frequencyMhz"), "signalStrength", "bssid")
BLUETOOTH = _reader("Bluetooth", ("technology", "txPower"), "signalStrength", "sourceAddress")
