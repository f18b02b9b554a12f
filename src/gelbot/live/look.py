"""How the page looks: its style sheet, and the few lines of script that viser has no setting for."""

from __future__ import annotations

ALONE = 'div[style*="opacity: 0.5"][style*="pointer-events: none"]'
"""What viser puts round all controls while the page is not connected."""
GONE = "Not connected: gelbot has ended or is out of reach. This is the past; nothing here stops anything."
"""In the place of the button that stops, while there is nobody to hear it."""
SILENT = "No word from gelbot for some seconds. The button may not be heard: be ready to stop it elsewhere."
"""Over that button, while the connection says nothing, as after a cable was pulled."""
SILENCE = 4.0
"""How long it says nothing then [s]: there is a word each second."""


def style(stop: str) -> str:
    """The style sheet; `stop`: the id of the button that stops, which stays in sight however far one scrolls."""
    return f"""<style>
.gelbot-status {{ padding: .1em .8em .4em; font-size: .85em; line-height: 1.45; }}
.gelbot-state {{ color: #fff; border-radius: .7em; padding: .05em .6em; margin-right: .35em; font-size: .92em; }}
.gelbot-small, .gelbot-hint {{ color: #777; font-size: .9em; }}
.gelbot-status > .gelbot-small {{ white-space: nowrap; overflow: hidden; text-overflow: ellipsis; }}
.gelbot-hint {{ padding: 0 .9em .5em; font-size: .78em; line-height: 1.35; }}
.gelbot-record {{ color: #c92a2a; margin-left: .6em; }}
.gelbot-message {{ color: #8a4b00; background: #fff6e5; border-radius: .3em; padding: .15em .5em; margin-top: .25em; }}
.gelbot-title span {{ white-space: nowrap; }}
button[data-size="compact-xs"] {{ padding-inline: 3px !important; }}
button[style*="gray-filled"] {{ background: #e9edf1 !important; color: #333 !important; font-weight: 500; }}
button[style*="gray-filled"]:hover {{ background: #dde3e9 !important; }}
.gelbot-error {{ color: #a01818; background: #fdecec; border-radius: .3em; padding: .2em .5em; margin: 0 .8em .5em;
  font-size: .8em; overflow-wrap: anywhere; }}
.gelbot-title {{ padding: .3em .9em .1em; font-size: .8em; color: #333; }}
.gelbot-seat {{ padding: 0 .9em .3em; font-size: .8em; color: #555; }}
.mantine-ScrollArea-content div:has(button[id="{stop}"]) {{ overflow: clip !important; }}
div:has(> button[id="{stop}"]) {{ position: sticky; top: 0; z-index: 30; background: #fff; padding-top: .35em; }}
button[id="{stop}"] {{ height: 3.1em !important; background: #d6201f !important; letter-spacing: .06em;
  font-weight: 700; box-shadow: 0 1px 4px rgba(160, 0, 0, .35); }}
button[id="{stop}"]:hover {{ background: #b71312 !important; }}
div:has(> button[id="{stop}"])::before {{ display: block; color: #700; font-size: .85em; font-weight: 600;
  border-radius: .3em; margin: .3em 0; padding: .2em .5em; }}
.gelbot-silent div:has(> button[id="{stop}"])::before {{ content: "{SILENT}"; background: #ffdcb0; }}
{ALONE} div:has(> button[id="{stop}"])::before {{ content: "{GONE}" !important; background: #ffbcbc; }}
{ALONE} :is(.gelbot-status, .gelbot-error, .gelbot-seat, button[id="{stop}"]) {{ display: none; }}
</style>"""


def beat(count: int) -> str:
    """What changes each second, unseen, as long as the page is served."""
    return f'<i class="gelbot-beat" hidden>{count}</i>'


SCRIPT = """
document.title = "gelbot";
if (!window.gelbotStops) {
  window.gelbotStops = true;
  window.addEventListener("keydown", (event) => {
    const at = document.activeElement;
    const isField = at && ["INPUT", "TEXTAREA", "SELECT"].includes(at.tagName);
    const takesSpace = isField && !at.readOnly && at.type !== "checkbox";
    if (!(event.key === "Escape" || (event.key === " " && !takesSpace)) || !at) return;
    at.blur();
    if (!isField) return;
    event.preventDefault();
    const again = { key: event.key, code: event.code, bubbles: true };
    document.documentElement.dispatchEvent(new KeyboardEvent("keydown", again));
  }, true);
  let last = "", heard = performance.now();
  setInterval(() => {
    const beat = document.querySelector(".gelbot-beat")?.textContent ?? "";
    if (beat !== last || document.hidden) [last, heard] = [beat, performance.now()];
    document.body.classList.toggle("gelbot-silent", performance.now() - heard > SILENCE);
  }, 500);
}
""".replace("SILENCE", f"{1e3 * SILENCE:g}")
"""The name of the window; the stop by key where viser's own keys are silent: Escape also in a field, the space bar
also on a button, which it does not press then; and whether the page is silent, which no tab is that nobody sees."""
