"""One glide of constant heading and glide angle (Kong et al., IROS 2021)."""
