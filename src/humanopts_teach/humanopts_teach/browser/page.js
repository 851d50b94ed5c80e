// Send keys and buttons with the number of the frame on which they were pressed.
(() => {
  const NAMES = {
    ArrowUp: 'up', ArrowDown: 'down', ArrowLeft: 'left', ArrowRight: 'right',
    Enter: 'enter', Escape: 'escape', Backspace: 'backspace',
  };
  const frame = () => Number(document.querySelector('.frame')?.textContent ?? 0);
  const send = (keys) => {
    if (window.socket?.connected) emitEvent('press', { keys, frame: frame() }); // offline: the result would not be visible
  };
  const input = () => document.querySelector('form.typed input, form.typed textarea');

  const known = (key) => JSON.parse(document.querySelector('[data-known]')?.dataset.known ?? '[]').includes(key);
  document.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.isComposing) return;
    const key = NAMES[event.key] ?? (event.key.length === 1 ? event.key : '');
    const field = input();
    if (field) {
      if (key === 'escape') send([key]);
      else if (document.activeElement !== field) field.focus();
      return; // the field handles editing, and its form submits
    }
    const button = event.target.closest?.('[data-keys]');
    if (button && (key === 'enter' || key === ' ')) return; // handled as a click
    if (!key) return;
    if (known(key) || (key.length === 1 && key !== ' ')) event.preventDefault(); // others scroll
    send([key]);
  });

  // A mouse acts on press, a finger on release, since it may be scrolling. Neither focuses the
  // button, so that Enter keeps its meaning.
  let pointed = 0, focused = null; // time; keys of the button that has the focus, '' for the heading
  const press = (event) => {
    const button = event.target.closest?.('[data-keys]');
    if (button) send(JSON.parse(button.dataset.keys));
    return button;
  };
  document.addEventListener('pointerdown', (event) => {
    if (event.button === 0 && event.pointerType === 'mouse' && press(event)) pointed = Date.now();
  });
  document.addEventListener('mousedown', (event) => {
    if (event.target.closest?.('[data-keys]')) event.preventDefault();
    else focused = null;
  });
  document.addEventListener('click', (event) => {
    if (event.detail > 0 && Date.now() - pointed < 1000) return;
    press(event);
  });
  let later; // a text that is typed before the page is connected
  document.addEventListener('submit', (event) => {
    event.preventDefault();
    const form = event.target;
    clearTimeout(later);
    if (window.socket?.connected) send(['ctrl-u', ...input().value.replace(/\s+/g, ' '), 'enter']);
    else later = setTimeout(() => form.isConnected && form.requestSubmit(), 100);
  });

  // Report each frame as displayed. A frame replaces elements: the focus returns to the button with
  // the same keys, or to the heading.
  document.addEventListener('focusin', ({ target }) => {
    focused = target.dataset?.keys ?? (target.matches('h1') ? '' : null);
  });
  let displayed = 0;
  new MutationObserver(() => {
    if (frame() !== displayed) { displayed = frame(); requestAnimationFrame(() => send([])); }
    const heading = document.querySelector('h1');
    // The browser collapses spaces in a title: another text would be set again and again.
    const title = (document.querySelector('h1:not(.heard), h2, h3') ?? heading)?.textContent.replace(/\s+/g, ' ').trim();
    if (title && document.title !== title) document.title = title;
    const field = input();
    if (field && !field.dataset.met) { // a text field has the focus as soon as it appears
      field.dataset.met = 'yes';
      if (matchMedia('(pointer: fine)').matches) { field.focus(); field.select(); }
    } else if (focused !== null && heading && document.activeElement === document.body) {
      heading.tabIndex = -1;
      (document.querySelector(`[data-keys='${CSS.escape(focused)}']`) ?? heading).focus({ preventScroll: true });
    }
  }).observe(document.documentElement, { childList: true, subtree: true });
})();
