"""What commands share: options, output, result files, interrupts, progress."""
