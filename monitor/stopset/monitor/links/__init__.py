"""Everything that touches a wire: CAN buses, CANopen dictionaries, zenoh. The only folder that imports those libraries."""
