"""From scans to landmarks: data association and what keyframes observe."""
