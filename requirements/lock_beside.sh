#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# The lines of lock.txt for packages that FILE does not name.
awk '{ name = tolower($0); sub(/[^a-z0-9._-].*/, "", name); gsub(/_/, "-", name) }
  NR == FNR { named[name]; next } !(name in named)' "$1" "$(dirname "${BASH_SOURCE[0]}")/lock.txt"
