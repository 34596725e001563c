"""``python -m vamgpu.cli`` does what ``vam`` does."""

from vamgpu.cli import main

raise SystemExit(main())
