"""Results and states of the valves for an MQTT broker. Nothing is ever subscribed to: a broker moves no valve."""
