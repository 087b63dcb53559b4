"""Messages of the dialect ``sagitta``: framing with its hash, requests, replies, parameters, telemetry.

Sans-IO. Restated from the public driver and simulator of one user of such a unit; no document of the vendor
was seen, so that whatever neither of them says is ASSUMED.
"""
