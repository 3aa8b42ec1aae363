"""What every wing uses: records, settings, files, images, cameras, compiled code."""
