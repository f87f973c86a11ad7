#!/bin/sh
# Starts bandit.awk. mawk reads its input in blocks unless it is interactive.
case $(awk -W version 2>/dev/null </dev/null) in
  mawk*) exec awk -W interactive -f bandit.awk ;;
  *) exec awk -f bandit.awk ;;
esac
