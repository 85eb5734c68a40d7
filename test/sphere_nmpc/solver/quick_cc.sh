#!/bin/sh
# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
exec cc "$@" -O0
