"""CANopen (CiA 301) as a star tracker card speaks it, sans-IO: bytes and times in, frames out.

``data_types``, ``objects`` and ``dictionary`` are the object dictionary and its values; ``sdo``,
``sdo_server``, ``pdo``, ``network_management``, ``emergency`` the protocols; ``node`` puts them together;
``card`` and ``communication`` hold the tables of the card; ``time_codes`` the two times it knows.
"""
