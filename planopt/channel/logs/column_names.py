"""Common names of log columns, by role."""

from planopt.channel.logs.log_table import LogTable, fold

ALIASES = {
    role: tuple(names.split())
    for role, names in {
        "longitude": "lon lng long longitude gpslon gpslongitude lond londeg longitudedeg rxlong "
        "rxlon currentlongitude laenge laengengrad",
        "latitude": "lat latitude gpslat gpslatitude latd latdeg latitudedeg rxlat currentlatitude "
        "breite breitengrad",
        "x": "xm x posx positionx east eastm easting mapx odomx posex posepositionx xposition "
        "localx",
        "y": "ym y posy positiony north northm northing mapy odomy posey posepositiony yposition "
        "localy",
        "power": "powerdbm power rssidbm rssi rsrpdbm rsrp signaldbm signal signallevel "
        "signalstrength signalstrengthdbm dbm rxpower rxpowerdbm rxlev rss rssdbm receivedpower "
        "rxrssi level powermw strength",
        "transmitter": "bssid ap mac tx txid transmitter transmitterid anchor beacon gateway "
        "gatewayid accesspoint cellid cell cid pci ssid station node from source",
        "name": "name id label",
        "height": "heightm height zm z antennaheight elevation",
        "time": "ts t time timestamp times datetime zeit date unixtime devicetime firstseen stamp",
    }.items()
}
"""Known names of columns by role, in lower case letters and digits, in order of preference."""


def alias(table: LogTable, role: str) -> str | None:
    """Return the column with a known name of this role, or None."""
    found = next((each for each in ALIASES[role] if each in table.folded), None)
    return None if found is None else table.folded[found]


def is_position(name: str) -> bool:
    """Return True if a column is named like a coordinate."""
    return any(fold(name) in ALIASES[role] for role in ("x", "y", "longitude", "latitude"))
